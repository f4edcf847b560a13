"""Experiments on captures: compare, ablate, relight, tradeoff."""
