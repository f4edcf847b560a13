"""`report.html`: one file that opens anywhere, with pictures, tables, curves, times and what they were measured on."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from ndf_mi import files
from ndf_mi.body.box import BOX_PADDING
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS as SPLIT_LABELS
from ndf_mi.experiments.records import MethodResult, Results
from ndf_mi.reports import tables
from ndf_mi.reports.flicker import flicker_section
from ndf_mi.reports.picture_rows import pictures_section
from ndf_mi.reports.pictures import line_chart
from ndf_mi.reports.style import CSS

_METRIC_NOTES = (
    f"Box figures look only at the pixels whose ray hits the body's 3D box, padded by {100 * BOX_PADDING:g} cm: whole-image "
    "figures are higher, because every method gets the background right. PSNR is taken an image at a time, then averaged; tPSNR a pair of "
    "frames at a time.",
    "SSIM is computed in the bounding rectangle of those pixels, with zeros outside them, a 7×7 uniform window and the "
    "sample covariance. With data_range 2, which some published figures use, it comes out higher; both are given.",
    "FLIP is NVIDIA's perceptual error at 67 pixels a degree, averaged over the same rectangle; 0 is equal, lower is "
    "better.",
)


def write_report(
    path: str | os.PathLike[str],
    results: Results,
    capture: Capture,
    pictures: Path,
    history: Sequence[Mapping[str, float]],
) -> None:
    """Writes the report.

    Args:
        path: the HTML file.
        results: what was measured; the first method is the one that differences refer to.
        capture: the truth of the pictures.
        pictures: the folder that `evaluate` wrote to, one folder a method.
        history: logged training steps of the first method (`seconds`, `psnr`); may be empty.
    """
    name = escape(capture.name)
    sections = [
        f"<h1>Neural deformable field and textured meshes on “{name}”</h1>",
        f'<p class="soft">{_lead(results)}</p>',
        _cards(results),
        "<h2>Figures</h2>",
        _headline_table(results),
        *(f'<p class="soft">{escape(note)}</p>' for note in (*tables.protocol_notes(results), *_mesh_notes(results))),
        pictures_section(results, capture, pictures),
        flicker_section(results, capture, pictures),
        "<h2>Training</h2>",
        _times(results),
        _curves(results, history),
        "<h2>All figures</h2>",
        *(_full_table(results, split) for split in results.splits()),
        *(f'<p class="soft">{escape(note)}</p>' for note in _METRIC_NOTES),
        "<h2>How it was made</h2>",
        _origin(results),
    ]
    files.write_text(
        path,
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{name}: comparison</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{CSS}</style>\n</head>\n<body>\n'
        + "\n".join(sections)
        + "\n</body>\n</html>\n",
    )


def _lead(results: Results) -> str:
    measured = results.about["measured"]
    parts = [f"{measured[split]} of {SPLIT_LABELS[split]}" for split in results.splits()]
    train = results.about["capture"]["train"]
    return (
        f"{'Both' if len(results.methods) == 2 else 'All'} were trained on the same images, {train['frames']} frames from "
        f"{train['cameras']} cameras. Images compared: {escape(', '.join(parts))}. {escape(tables.protocol_sentence(results))}"
    )


def _cards(results: Results) -> str:
    cards = []
    for split in (split for split in _held_out(results) if split != "sequence"):
        first, *others = results.methods
        ahead = []
        for other in others:
            gain = tables.difference(first.mean(split, "box_psnr"), other.mean(split, "box_psnr"))
            ahead.append(f"<li>{tables.signed('box_psnr', gain)} dB against {escape(tables.lower(other.label))}</li>")
        value = tables.figure("box_psnr", first.mean(split, "box_psnr"))
        cards.append(
            f'<div class="card"><h2>{escape(first.label)}, {SPLIT_LABELS[split]}</h2>'
            f'<div class="figure">{value} <small>dB box PSNR</small></div><ul>{"".join(ahead)}</ul></div>'
        )
    return f'<div class="cards">{"".join(cards)}</div>'


def _held_out(results: Results) -> list[str]:
    return [split for split in results.splits() if split != "train"]


def _headline_table(results: Results) -> str:
    splits = _held_out(results)
    keys = tables.headline(results)
    labels = (SPLIT_LABELS[split].capitalize() for split in splits)
    groups = "".join(f'<th class="group" colspan="{len(keys)}">{label}</th>' for label in labels)
    heads = "".join(f"<th>{_label(key)}</th>" for key in keys) * len(splits)
    merged = zip(*(tables.rows(results, split, keys) for split in splits), strict=True)
    body = "".join(_row(p[0].label, [cell for row in p for cell in row.cells], p[0].difference) for p in merged)
    head = f"<thead><tr><th></th>{groups}</tr><tr><th></th>{heads}</tr></thead>"
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'


def _full_table(results: Results, split: str) -> str:
    keys = tuple(metrics.LABELS)
    heads = "".join(f"<th>{_label(key)}</th>" for key in keys)
    body = "".join(_row(row.label, list(row.cells), row.difference) for row in tables.rows(results, split, keys))
    count = results.about["measured"][split]
    pairs = sum(len(known.tpsnr) for known in results.methods[0].flicker if known.sequence.split == split)
    couples = f"{pairs} pair{'s' * (pairs > 1)} of frames"
    over = f"{count} images, of tPSNR over {couples}" if pairs else f"{count} images"
    caption = f"<caption>{SPLIT_LABELS[split].capitalize()}, means over {over}</caption>"
    head = f"<thead><tr><th></th>{heads}</tr></thead>"
    return f'<div class="scroll"><table>{caption}{head}<tbody>{body}</tbody></table></div>'


def _label(key: str) -> str:
    """A metric's name as a column's head, broken in as few places as may be."""
    return escape(metrics.LABELS[key]).replace("Box ", "Box&nbsp;").replace("range ", "range&nbsp;").replace("Whole-", "Whole&#8209;")


def _row(label: str, cells: Sequence[tables.Cell], difference: bool) -> str:
    tds = "".join(f'<td class="best">{cell.text}</td>' if cell.best else f"<td>{cell.text}</td>" for cell in cells)
    return f'<tr{" class=difference" if difference else ""}><th scope="row">{escape(label)}</th>{tds}</tr>'


def _times(results: Results) -> str:
    body = ""
    for method in results.methods:
        facts = method.metadata
        cells = (
            tables.duration(facts.get("seconds")),
            "–" if facts.get("steps") is None else f"{facts['steps']:,}",
            tables.duration(method.seconds_an_image()),
        )
        body += _row(method.label, [tables.Cell(text) for text in cells], False)
    head = "<thead><tr><th></th><th>Training</th><th>Steps</th><th>Rendering, an image</th></tr></thead>"
    return f'<div class="scroll"><table class="facts-times">{head}<tbody>{body}</tbody></table></div>'


def _curves(results: Results, history: Sequence[Mapping[str, float]]) -> str:
    charts = []
    logged = [(entry["seconds"], entry["psnr"]) for entry in history if "seconds" in entry and "psnr" in entry]
    if logged:
        seconds, psnr = zip(*logged, strict=True)
        label = results.methods[0].label
        charts.append(line_chart([(label, seconds, psnr)], "seconds", "dB", f"{label}: PSNR on the rays drawn"))
    meshes = []
    for method in results.methods:
        points = [(s, -10 * np.log10(loss)) for _, s, loss in method.metadata.get("history", []) if loss > 0]
        if points:
            seconds, psnr = zip(*points, strict=True)
            meshes.append((method.label, seconds, psnr))
    if meshes:
        charts.append(line_chart(meshes, "seconds", "dB", "Mesh: PSNR on training images, body's rectangle"))
    return f'<div class="charts">{"".join(charts)}</div>'


def _mesh_notes(results: Results) -> list[str]:
    notes = [note for note in map(tables.mesh_note, results.methods) if note]
    equal = results.about["equal_seconds"]
    keys = {method.key for method in results.methods}
    for method in results.methods:
        converged = method.metadata.get("converged") and method.metadata["seconds"] <= equal
        if converged and method.key.replace("converged", "equal-time") not in keys:
            notes.append(
                f"{method.label}: this was before the field's training time ({tables.duration(equal)}) was up, so it stands for "
                "equal time too."
            )
    return notes


def _origin(results: Results) -> str:
    about = results.about
    facts = {
        "Command": f"<pre>{escape(about['command'])}</pre>",
        "Run": escape(about["run"]),
        "Capture": f"{escape(about['capture']['name'])}, digest {escape(about['capture']['digest'][:16])}…",
        **{label: escape(value) for label, value in about["machine"].items()},
        "Protocol": escape(tables.protocol_sentence(results)),
        "Comparison": _settings(about["settings"]),
    }
    for method in results.methods:
        facts[method.label] = _method_facts(method)
    body = "".join(f"<tr><th>{escape(label)}</th><td>{value}</td></tr>" for label, value in facts.items())
    return f'<table class="facts"><tbody>{body}</tbody></table>'


def _method_facts(method: MethodResult) -> str:
    plain = {key: value for key, value in method.metadata.items() if isinstance(value, (str, int, float))}
    parts = [_settings(plain)]
    for key, value in method.metadata.items():
        if isinstance(value, dict) and value:
            label = "training loss by learning rate" if key == "sweep" else key
            parts.append(f"{escape(label)}: {_settings(value)}")
    return "<br>".join(parts)


def _settings(values: Mapping[str, object]) -> str:
    def text(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, float) else str(value)

    return escape(", ".join(f"{key.replace('_', ' ')} {text(value)}" for key, value in values.items()))


def command_line(arguments: Sequence[str]) -> str:
    """The command as a shell takes it."""
    return shlex.join(["ndf-mi", *arguments])
