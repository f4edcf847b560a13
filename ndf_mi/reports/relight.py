"""The report on relighting: one table over both lights, and pictures under each."""

from __future__ import annotations

import os
from collections.abc import Mapping
from html import escape

from ndf_mi import files
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS as SPLIT_LABELS
from ndf_mi.experiments.records import Results
from ndf_mi.experiments.relight import LIGHTINGS, SEEN, UNSEEN, Relighting
from ndf_mi.reports import tables
from ndf_mi.reports.picture_rows import pictures_section
from ndf_mi.reports.style import CSS

KEYS = ("box_psnr", "box_ssim")


def write_relight_report(path: str | os.PathLike[str], relighting: Relighting) -> None:
    """Writes the report of a finished relighting as one HTML file."""
    results, name = relighting.results, escape(relighting.captures[SEEN].name)
    about = results[SEEN].about
    sections = [
        f"<h1>“{name}” in another light</h1>",
        f'<p class="soft">Both were trained on the images under the seen light, {escape(about["capture"]["path"])}; nothing was learnt '
        f'from those under the unseen light, {escape(results[UNSEEN].about["capture"]["path"])}. All images are held out.</p>',
        "<h2>Figures</h2>",
        _table(results),
        *(f'<p class="soft">{escape(note)}</p>' for note in notes(results)),
    ]
    for lighting in LIGHTINGS:
        pictures = pictures_section(results[lighting], relighting.captures[lighting], relighting.pictures(lighting))
        sections.append(pictures.replace("<h2>Pictures</h2>", f"<h2>Under the {lighting} light</h2>"))
    facts = {"Command": f"<pre>{escape(about['command'])}</pre>", "Run": escape(about["run"]),
             **{label: escape(value) for label, value in about["machine"].items()}}
    rows = "".join(f"<tr><th>{escape(label)}</th><td>{value}</td></tr>" for label, value in facts.items())
    sections += ["<h2>How it was made</h2>", f'<table class="facts"><tbody>{rows}</tbody></table>']
    files.write_text(
        path,
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{name}: relighting</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{CSS}</style>\n</head>\n<body>\n'
        + "\n".join(sections) + "\n</body>\n</html>\n",
    )


def columns(results: Mapping[str, Results]) -> list[tuple[str, str]]:
    """Light and split of each group of columns."""
    return [(lighting, split) for lighting in LIGHTINGS for split in results[lighting].splits()]


def notes(results: Mapping[str, Results]) -> list[str]:
    """What is to be said below the table: noise of the pictures, and how the mesh was trained."""
    parts = [f"{method.label} {method.metadata['noise_psnr']:.1f} dB under the {lighting} light"
             for lighting in LIGHTINGS for method in results[lighting].methods if method.metadata.get("noise_psnr") is not None]
    told = [f"Noise of the pictures alone, as PSNR in the box: {', '.join(parts)}."] if parts else []
    lattice = results[SEEN].about["settings"].get("lattice", 0.0)
    if lattice:
        told.append(f"The field is shown on a lattice of {1000 * lattice:g} mm, as it was trained, not itself.")
    return told + [note for method in results[SEEN].methods if (note := tables.mesh_note(method))]


def _table(results: Mapping[str, Results]) -> str:
    groups, heads, parts = "", "", []
    for lighting, split in columns(results):
        groups += f'<th class="group" colspan="{len(KEYS)}">{lighting.capitalize()} light, {SPLIT_LABELS[split]}</th>'
        heads += "".join(f"<th>{escape(metrics.LABELS[key])}</th>" for key in KEYS)
        parts.append(tables.rows(results[lighting], split, KEYS))
    body = ""
    for row in zip(*parts, strict=True):
        cells = "".join(f'<td{" class=best" if cell.best else ""}>{cell.text}</td>' for part in row for cell in part.cells)
        body += f'<tr{" class=difference" if row[0].difference else ""}><th scope="row">{escape(row[0].label)}</th>{cells}</tr>'
    return (f'<div class="scroll"><table><thead><tr><th></th>{groups}</tr><tr><th></th>{heads}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>")
