"""Trains a field on a capture: batches, steps, losses, guards, checkpoints."""
