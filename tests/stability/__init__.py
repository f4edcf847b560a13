"""Computations and their gradients at the extremes of every input, compared with float64 references.

The modules ``test_*`` are tests for pytest, which :mod:`ndf_mi.commands.stability` runs. The others hold the
references.
"""
