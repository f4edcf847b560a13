"""The report's style sheet: system fonts, the reader's light or dark theme, tabular figures."""

CSS = """
:root { color-scheme: light dark; --ink: #1d2127; --soft: #667079; --rule: #dcdfe3; --paper: #ffffff; --shade: #f5f6f8;
  --accent: #1f6fb2; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e6e9; --soft: #98a1aa; --rule: #353a41; --paper: #16181c; --shade: #1f2227; --accent: #6cb1ea; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 3rem 1.5rem 5rem; max-width: 68rem; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.9rem; font-weight: 600; line-height: 1.2; margin: 0 0 .4rem; letter-spacing: -.01em; }
h2 { font-size: 1.2rem; font-weight: 600; margin: 3rem 0 .6rem; }
h3 { font-size: 1rem; font-weight: 600; margin: 2rem 0 .6rem; }
p { max-width: 46rem; margin: .5rem 0; }
.soft, figcaption, caption { color: var(--soft); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(17rem, 1fr)); gap: 1rem; margin: 1.8rem 0 0; }
.card { background: var(--shade); border-radius: .5rem; padding: 1.1rem 1.3rem; }
.card h2 { margin: 0; font-size: .95rem; color: var(--soft); font-weight: 500; }
.card .figure { font-size: 2.1rem; font-weight: 600; font-variant-numeric: tabular-nums; line-height: 1.35; }
.card .figure small { font-size: 1rem; font-weight: 400; color: var(--soft); }
.card ul { list-style: none; margin: .2rem 0 0; padding: 0; font-variant-numeric: tabular-nums; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .8rem 0; min-width: 100%; }
caption { text-align: left; padding-bottom: .5rem; font-size: .9rem; }
th, td { padding: .38rem .8rem; text-align: right; border-bottom: 1px solid var(--rule); white-space: nowrap; }
th { font-weight: 500; color: var(--soft); font-size: .88rem; }
thead th { white-space: normal; vertical-align: bottom; min-width: 5.6rem; }
thead th.group { text-align: center; color: var(--ink); border-bottom: 2px solid var(--rule); }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
tbody th { color: var(--ink); font-size: 1rem; }
td.best { font-weight: 650; }
tr.difference th, tr.difference td { color: var(--accent); font-size: .92rem; }
table.facts { min-width: 0; }
table.facts td { text-align: left; white-space: normal; }
table.facts th { text-align: left; padding-left: 0; vertical-align: top; font-size: .95rem; color: var(--soft); }
.row { display: grid; gap: .4rem .6rem; margin: 1rem 0 2rem; align-items: start; }
.row figure { margin: 0; }
.row img { width: 100%; display: block; border-radius: 3px; background: var(--shade); }
.row .head { font-size: .8rem; line-height: 1.3; font-weight: 500; align-self: end; }
.row figcaption { font-size: .8rem; line-height: 1.3; font-variant-numeric: tabular-nums; padding-top: .15rem; }
.row.strip .head { align-self: center; }
.scale { display: flex; align-items: center; gap: .6rem; font-size: .85rem; color: var(--soft); margin: .8rem 0; }
.scale .bar { width: 12rem; height: .7rem; border-radius: 2px; }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(20rem, 1fr)); gap: 1rem; }
.charts svg { width: 100%; height: auto; }
code, pre { font-family: ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace; font-size: .85rem; }
pre { margin: 0; background: var(--shade); padding: .8rem 1rem; border-radius: .4rem; overflow-x: auto; }
@media print { body { max-width: none; padding: 0; } .row { break-inside: avoid; } }
"""
