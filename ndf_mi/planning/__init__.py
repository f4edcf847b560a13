"""What a capture's training images say about the model that it needs: observations, estimates, findings, and the plan that follows."""
