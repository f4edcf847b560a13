"""The report of a study of speed and accuracy: Pareto fronts, pictures of their points, and a table."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from skimage.transform import resize

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import SPLITS, View
from ndf_mi.experiments.trade import memory
from ndf_mi.experiments.trade.points import RUN
from ndf_mi.experiments.trade.results import Row, Trade, reference_of
from ndf_mi.reports import page, tables
from ndf_mi.reports.fronts import WORTH, Group, comparable, groups
from ndf_mi.reports.page import Fact
from ndf_mi.reports.pictures import PictureRow, Shot, absolute_error, body_window, error_scale, view_row
from ndf_mi.reports.tables import Cell, Table

_COLUMNS = (
    "seconds per frame", "fastest – slowest repeat", "peak memory (MiB)", "PSNR against truth",
    "SSIM against truth", "PSNR against convergence", "PSNR of convergence against truth", "on front",
    "training", "loading per frame",
)


def write_trade_report(path: str | os.PathLike[str], trade: Trade, capture: Capture, folder: Path) -> None:
    """Writes the HTML file `path`, and `table.md` next to it.

    Args:
        trade: what was measured.
        capture: the truth.
        folder: the study's folder; its subfolder `pictures` holds the pictures.
    """
    about, found = trade.about, groups(trade)
    page.write_page(
        path, "tradeoff.html.j2",
        name=capture.name,
        repeats=about["settings"]["repeats"],
        groups=found,
        rows={group.title: front_rows(group, capture, folder / "pictures") for group in found},
        table=table(trade),
        worth=WORTH,
        earlier=_earlier(trade),
        memory=memory.MEANING,
        origin=page.origin(about, *_facts(trade)),
    )
    files.write_text(Path(path).with_name("table.md"), markdown(trade))


def table(trade: Trade) -> Table:
    """All points, with their figures as means over the views."""
    on_front = {group.rows[i].key for group in groups(trade) for i in group.front}
    rows = []
    for row in trade.rows:
        label = row.label + " †" * (row.session != trade.about["session"])
        rows.append(tables.Row(label, tuple(map(Cell, _cells(row, row.key in on_front)))))
    return Table(_COLUMNS, tuple(rows), corner="Point")


def markdown(trade: Trade) -> str:
    """The table in Markdown."""
    return table(trade).markdown() + (f"\n{earlier}\n" if (earlier := _earlier(trade)) else "")


def _cells(row: Row, on_front: bool) -> list[str]:
    steps, training, loading = (row.metadata.get(key) for key in ("steps", "training_seconds", "loading"))
    return [
        "–" if row.frame_seconds is None else f"{row.frame_seconds:.3f}",
        f"{min(row.seconds):.3f} – {max(row.seconds):.3f}" if row.seconds else "–",
        "–" if row.memory is None else f"{row.memory / 2**20:.0f}",
        tables.figure("psnr", row.truth()),
        tables.figure("box_ssim", row.truth("box_ssim")),
        tables.figure("psnr", row.converged()),
        tables.figure("psnr", row.model()),
        "●" if on_front else "",
        "" if row.field == RUN else f"{tables.count(steps or 0, 'step')}, {tables.duration(training)}",
        "" if loading is None else tables.duration(loading),
    ]


def _earlier(trade: Trade) -> str:
    """What the mark † means; empty where no row carries it."""
    rows = [row for row in trade.rows if row.session != trade.about["session"]]
    if not rows:
        return ""
    other = sum(not comparable(trade, row) for row in rows)
    text = "† was timed by an earlier call, not in turns with the other points."
    if other:
        text += f" {other} of these were timed on another machine or with other versions and are on no front."
    return text


def _facts(trade: Trade) -> list[Fact]:
    about = trade.about
    views = [view["split"] for view in about["views"]]
    images = ", ".join(f"{views.count(split)} of {SPLITS[split]}" for split in dict.fromkeys(views))
    size = " × ".join(map(str, about["size"]))
    errors = f"{images}, {size} pixels; {metrics.LABELS['box_psnr']}, mean over the images"
    run = about["run"]
    facts = [
        Fact("Run", (f"{run['path']}, preset {run['preset']}, digest {run['digest'][:16]}…",)),
        page.capture_fact(about),
        Fact("Images compared", (errors,)),
        Fact("Images timed", (f"{about['sessions'][about['session']]['timed']} of these",)),
    ]
    if about["paths"]:
        unknown = "a constant environment, because the capture’s light is unknown"
        light = "the capture’s" if about["lit"] else unknown
        facts.append(Fact("Light of path tracing", (light,)))
    return facts


def front_rows(group: Group, capture: Capture, pictures: Path) -> list[PictureRow]:
    """A row for a view of each split: the front's fastest point, knee and best point, each with its error.

    `pictures` holds a folder for each point, by its key, and for each converged picture.
    """
    marked = (group.front[0], group.knee, group.front[-1])
    chosen = list(dict.fromkeys(index for index in marked if index is not None))
    first: dict[str, View] = {}
    for figures in group.rows[chosen[0]].figures:
        first.setdefault(figures.view.split, figures.view)
    return [_row(group, chosen, view, capture, pictures) for view in first.values()]


def _row(group: Group, chosen: Sequence[int], view: View, capture: Capture, pictures: Path) -> PictureRow:
    rows = [group.rows[i] for i in chosen]
    images = [read_picture(pictures / row.key, view) for row in rows]
    truth = capture.image(view.camera, view.frame)
    if truth.shape != images[0].shape:
        truth = np.asarray(resize(truth, images[0].shape, order=1, anti_aliasing=True), dtype=np.float32)
    # Each trained field has a converged picture of its own; only the truth is common to all.
    converged = read_picture(pictures / reference_of(rows[0].field, None if rows[0].by_paths else 1), view)
    references = [truth if group.by_truth else read_picture(pictures / row.reference, view) for row in rows]
    window = body_window(capture, view, truth.shape)
    errors = [absolute_error(a, b) for a, b in zip(references, images, strict=True)]
    top = error_scale(errors)
    where = f"camera {view.camera}, frame {view.frame}"
    shots = [Shot("Truth", truth[window], f"{SPLITS[view.split]}, {where}")] if group.by_truth else []
    if not group.by_truth or len({row.field for row in rows}) == 1:
        error = absolute_error(truth, converged)[window] if group.by_truth else None
        shots.append(Shot("Converged", converged[window], where, error))
    for index, row, image, error in zip(chosen, rows, images, errors, strict=True):
        name = "Knee" if index == group.knee else "Fastest" if index == group.front[0] else "Best"
        found = next(f for f in row.figures if f.view == view)
        psnr = tables.figure("psnr", found.truth.get("box_psnr") if group.by_truth else found.converged)
        caption = f"{tables.duration(row.frame_seconds)}, {psnr} dB"
        shots.append(Shot(f"{name}: {row.label}", image[window], caption, error[window]))
    return view_row(shots, view, top, "the truth" if group.by_truth else "convergence")
