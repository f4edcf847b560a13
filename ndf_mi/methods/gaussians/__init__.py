"""Gaussian primitives on the body."""
