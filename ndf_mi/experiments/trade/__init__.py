"""What speed costs in accuracy: the points of the study, their figures and Pareto fronts."""
