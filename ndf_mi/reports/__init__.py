"""Reports of experiments: one HTML file each, made of templates and one style sheet."""

from __future__ import annotations

from ndf_mi.optional import require

# Missing packages are reported before any work is done, not when its report is written.
for _module in ("jinja2", "matplotlib", "flip_evaluator"):
    require(_module, extra="report")
