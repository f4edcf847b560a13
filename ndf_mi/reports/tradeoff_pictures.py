"""Pictures of the ends and the knee of each Pareto front, with the truth and the converged picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from skimage.transform import resize

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import SPLITS, View
from ndf_mi.experiments.trade.results import Row, reference_of
from ndf_mi.reports import tables
from ndf_mi.reports.fronts import Group
from ndf_mi.reports.pictures import PictureRow, Shot, absolute_error, body_window, error_scale, view_row


def front_rows(group: Group, capture: Capture, pictures: Path) -> list[PictureRow]:
    """A row for a view of each split: the front's fastest point, knee and best point, each with its error.

    Args:
        group: the points.
        capture: the truth.
        pictures: a folder for each point, by its key, and for each converged picture.
    """
    marked = (group.front[0], group.knee, group.front[-1])
    chosen = list(dict.fromkeys(index for index in marked if index is not None))
    return [_row(group, chosen, view, capture, pictures) for view in _views(group.rows[chosen[0]])]


def _views(row: Row) -> list[View]:
    """One view of each split."""
    first: dict[str, View] = {}
    for figures in row.figures:
        first.setdefault(figures.view.split, figures.view)
    return list(first.values())


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
