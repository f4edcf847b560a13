"""Numbers at their extremes: cases that hold what is computed, and its gradient, against float64; see docs/stability.md."""
