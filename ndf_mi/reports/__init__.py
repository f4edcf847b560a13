"""Reports of experiments: one HTML file each, made of templates and one style sheet.

A report is a module that turns records into values (`tables.Table`, `charts.Chart`, `pictures.PictureRow`,
`page.Fact`) and a template of the same name that places them. How a value looks is decided in
`templates/macros.html.j2` and `style.css`. Labels, order and columns come from the records, so that reports
know no methods.
"""

from __future__ import annotations

from ndf_mi.optional import require

# Missing packages are reported before any work is done, not when its report is written.
for _module in ("jinja2", "matplotlib", "flip_evaluator"):
    require(_module, extra="report")
