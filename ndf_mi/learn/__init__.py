"""Fitting a field to a capture: rays, loss, schedule, loop, checkpoints."""
