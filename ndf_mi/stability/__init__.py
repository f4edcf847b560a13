"""Numbers at their extremes: cases that hold what is computed, and its gradient, against float64; see docs/stability.md."""

from __future__ import annotations

from ndf_mi.optional import require

require("trimesh", extra="stability")  # before any case runs
