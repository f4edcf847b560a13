"""The study's page: the fronts with what they beat, a table of all points, and pictures at the knees."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS
from ndf_mi.experiments.trade import memory
from ndf_mi.experiments.trade.front import knee, pareto_front
from ndf_mi.experiments.trade.points import RUN
from ndf_mi.experiments.trade.results import Row, Trade
from ndf_mi.render.settings import CONVERGED_SAMPLES
from ndf_mi.reports import tables
from ndf_mi.reports.charts import front_chart
from ndf_mi.reports.style import CSS
from ndf_mi.reports.tradeoff_pictures import knees

#: dB that a slower point must be better by to be on a front: half of what tables show.
WORTH = 0.005


@dataclass(frozen=True)
class Group:
    """Rows that may be compared with one another in one quality.

    Attributes:
        title, about: for people.
        quality: label of what is plotted.
        rows: those that have it.
        values: their quality in dB, higher is better.
        front: indices of the rows that no other one beats, by rising seconds.
        knee: index of one of them, or None.
        reference: (label, dB) of a line across, or None.
    """

    title: str
    about: str
    quality: str
    rows: list[Row]
    values: list[float]
    front: list[int]
    knee: int | None
    reference: tuple[str, float] | None = None


def groups(trade: Trade) -> list[Group]:
    """The trades that there are in a study: by quadrature against the truth and against convergence, trained fields, path traced ones.

    What an earlier call timed is among them where machine and versions were the same.
    """
    rows = [row for row in trade.rows if comparable(trade, row)]
    drawn = [row for row in rows if row.field == RUN and not row.by_paths]
    paths = [row for row in rows if row.field == RUN and row.by_paths]
    fields = [row for row in rows if row.field != RUN]
    usual = trade.row("usual")
    model = None if usual is None else usual.model()
    truth, convergence = "box PSNR against the truth (dB)", "box PSNR against convergence (dB)"
    found = [
        _group("Against the truth", "The run as it is, drawn in different ways. The dashed line is the same field drawn to convergence: "
               "what lies below it is error of rendering, what is missing above it is error of the model.",
               truth, drawn, [row.truth() for row in drawn], None if model is None else ("converged", model)),
        _group("Against convergence", f"The same pictures against the same field drawn with {CONVERGED_SAMPLES} samples along the same "
               "rays, each ray to its end: error of rendering alone.", convergence, drawn, [row.converged() for row in drawn]),
        _group("Other fields", "Fields that the study trained, all for as long, drawn as usual. They are to be compared with one another: "
               "the run itself may have been trained for longer.", truth, fields, [row.truth() for row in fields]),
        _group("Path tracing", "The field by `volpath`: another picture, lit, on fewer pixels, in one view. Noise is error.",
               convergence, paths, [row.converged() for row in paths]),
        _group("Path tracing, against the truth", "The same against the capture, under its light.",
               truth, paths, [row.truth() for row in paths]),
    ]
    return [group for group in found if group is not None]


def comparable(trade: Trade, row: Row) -> bool:
    """Whether a row was timed by this call, or by an earlier one on the same machine with the same versions."""
    sessions = trade.about["sessions"]
    return bool(sessions.get(row.session, {}).get("machine") == sessions[trade.about["session"]]["machine"])


def earlier(trade: Trade) -> str:
    """What the mark of rows that an earlier call timed means; empty where there are none."""
    rows = [row for row in trade.rows if row.session != trade.about["session"]]
    if not rows:
        return ""
    other = sum(not comparable(trade, row) for row in rows)
    on = f"; {other} of these on another machine or with other versions, and not held against the rest" if other else ""
    return f"† was timed by an earlier call, not in turns with the others{on}."


def markdown(trade: Trade) -> str:
    """The points as a table in Markdown."""
    heads, rows = _table(trade)
    lines = ["| " + " | ".join(heads) + " |", "| --- |" + " --- |" * (len(heads) - 1)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines + (["", earlier(trade)] if earlier(trade) else [])) + "\n"


def write_trade_report(path: str | os.PathLike[str], trade: Trade, capture: Capture, folder: Path) -> None:
    """Writes the page, and `table.md` beside it.

    Args:
        path: the HTML file.
        trade: what was measured.
        capture: the truth of the pictures.
        folder: of the study.
    """
    heads, rows = _table(trade)
    found = groups(trade)
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + f'<th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:]) + "</tr>"
                   for row in rows)
    name = escape(capture.name)
    parts = "\n".join(_section(group) for group in found)
    page = (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{name}: speed and accuracy</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{CSS}\n.trade svg {{ width: 100%; max-width: 52rem; '
        f'height: auto; }}</style>\n</head>\n<body>\n<h1>Speed for accuracy on “{name}”</h1>\n'
        f'<p class="soft">Seconds a frame, from the posed body’s vertices to the picture in memory, kernels compiled before: the median of '
        f"{trade.about['settings']['repeats']} repeats, in each of which every point is drawn once in each of the views timed, in random "
        f"order.</p>\n{parts}\n<h2>Pictures</h2>\n{knees(found, trade, capture, folder)}\n"
        f'<h2>All points</h2>\n<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>\n'
        f'<p class="soft">● is on the front of its group: nothing as quick is better, and nothing quicker is as good to {WORTH:g} dB. '
        f'{escape(earlier(trade))} Memory is {escape(memory.MEANING)}</p>\n'
        f'<h2>How it was made</h2>\n<pre>{escape(trade.about["command"])}</pre>\n'
        f'<table class="facts"><tbody>{_facts(trade)}</tbody></table>\n</body>\n</html>\n'
    )
    files.write_text(path, page)
    files.write_text(Path(path).with_name("table.md"), markdown(trade))


def _group(title: str, about: str, quality: str, rows: Sequence[Row], values: Sequence[float | None],
           reference: tuple[str, float] | None = None) -> Group | None:
    """A group of those rows that have seconds and a finite quality; None where there are none."""
    kept = [(row, value) for row, value in zip(rows, values, strict=True)
            if row.frame_seconds is not None and value is not None and math.isfinite(value)]
    if not kept:
        return None
    seconds, quality_of = [row.frame_seconds or 0.0 for row, _ in kept], [value for _, value in kept]
    front = pareto_front(seconds, quality_of, WORTH)
    at = knee([seconds[i] for i in front], [quality_of[i] for i in front])
    return Group(title, about, quality, [row for row, _ in kept], quality_of, front, None if at is None else front[at], reference)


def _section(group: Group) -> str:
    return (f'<h2>{escape(group.title)}</h2>\n<p class="soft">{_inline(group.about)}</p>\n{_chart(group)}\n'
            f"<p>{escape(_told(group))}</p>")


def _chart(group: Group) -> str:
    points = [(row.label, row.frame_seconds or 0.0, value) for row, value in zip(group.rows, group.values, strict=True)]
    return (f'<div class="trade">'
            f'{front_chart(points, group.front, group.knee, "seconds a frame", group.quality, "", group.reference)}</div>')


def _told(group: Group) -> str:
    """What a front says, in a sentence."""
    def point(index: int) -> str:
        row = group.rows[index]
        return f"{row.label} ({tables.duration(row.frame_seconds)}, {group.values[index]:.2f} dB)"

    first, last = group.front[0], group.front[-1]
    if len(group.front) == 1:
        return f"Of {len(group.rows)} points one beats all others: {point(first)}."
    text = f"{len(group.front)} of {len(group.rows)} points are on the front, from {point(first)} to {point(last)}"
    return text + (f"; its knee is {point(group.knee)}." if group.knee is not None else "; it has no knee.")


def _table(trade: Trade) -> tuple[list[str], list[list[str]]]:
    heads = ["", "seconds a frame", "least – most", "memory, MiB", "truth, PSNR", "truth, SSIM", "converged, PSNR", "model, PSNR", "front",
             "training", "loading a frame"]
    on_front = {group.rows[i].key for group in groups(trade) for i in group.front}
    rows = []
    for row in trade.rows:
        spread = f"{min(row.seconds):.3f} – {max(row.seconds):.3f}" if row.seconds else "–"
        own = row.field == RUN
        training = "" if own else f"{row.metadata.get('steps') or 0:,} steps, {tables.duration(row.metadata.get('training_seconds'))}"
        label = row.label + " †" * (row.session != trade.about["session"])
        rows.append([label, "–" if row.frame_seconds is None else f"{row.frame_seconds:.3f}", spread,
                     "–" if row.memory is None else f"{row.memory / 2**20:.0f}", tables.figure("psnr", row.truth()),
                     tables.figure("box_ssim", row.truth("box_ssim")), tables.figure("psnr", row.converged()),
                     tables.figure("psnr", row.model()), "●" if row.key in on_front else "", training,
                     tables.duration(row.metadata["loading"]) if row.metadata.get("loading") is not None else ""])
    return heads, rows


def _facts(trade: Trade) -> str:
    about = trade.about
    views: dict[str, int] = {}
    for view in about["views"]:
        views[view["split"]] = views.get(view["split"], 0) + 1
    facts = {"Run": f"{about['run']['path']}, preset {about['run']['preset']}, digest {about['run']['digest'][:16]}…",
             "Capture": f"{about['capture']['name']}, digest {about['capture']['digest'][:16]}…",
             "Errors over": ", ".join(f"{count} of {LABELS[split]}" for split, count in views.items())
             + f", {about['size'][0]} × {about['size'][1]} pixels; {metrics.LABELS['box_psnr']}, the mean over the views",
             "Timed": f"{about['sessions'][about['session']]['timed']} of these views", **about["machine"]}
    if about["paths"]:
        facts["Light of path tracing"] = "the capture’s" if about["lit"] else "a constant environment, as the capture’s is not known"
    return "".join(f"<tr><th>{escape(key)}</th><td>{escape(str(value))}</td></tr>" for key, value in facts.items())


def _inline(text: str) -> str:
    """Text with `code` in HTML."""
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if index % 2 else part for index, part in enumerate(parts))
