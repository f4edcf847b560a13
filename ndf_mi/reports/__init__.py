"""Reports: one HTML file each."""

from __future__ import annotations

from ndf_mi.optional import require

for _module in ("jinja2", "matplotlib", "flip_evaluator"):
    require(_module, extra="report")  # before any work is done, rather than when its report is written
