"""Decides from a capture's training images which parts of the model it needs."""
