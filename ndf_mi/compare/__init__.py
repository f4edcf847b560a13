"""Methods compared on a capture's held-out views and poses: metrics, baselines, evaluation, report."""
