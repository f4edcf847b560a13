"""Rows of pictures: the truth, each method, and error maps on one scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import SPLITS, Results, View
from ndf_mi.reports import tables
from ndf_mi.reports.pictures import PictureRow, Shot, absolute_error, body_window, error_scale, view_row

#: How many views of a split are shown; one of the splits that are not listed.
VIEWS: Mapping[str, int] = {"novel_view": 4, "novel_pose": 4}


@dataclass(frozen=True)
class Rows:
    """Rows of pictures by split, under the split's name, and the upper end of the error maps' scale."""

    splits: dict[str, list[PictureRow]]
    top: float


def picture_rows(results: Results, capture: Capture, pictures: Path) -> Rows:
    """Up to `VIEWS` views of each split, with error maps that share one scale.

    Args:
        results: what was measured.
        capture: the truth.
        pictures: a folder for each method, by its key.
    """
    views = {split: spread(results, split, VIEWS.get(split, 1)) for split in results.splits()}
    shots = {view: _shots(results, capture, pictures, view) for chosen in views.values() for view in chosen}
    top = error_scale([shot.error for row in shots.values() for shot in row if shot.error is not None])
    rows = {split: [view_row(shots[view], view, top) for view in chosen] for split, chosen in views.items()}
    return Rows({SPLITS[split].capitalize(): found for split, found in rows.items()}, top)


def spread(results: Results, split: str, count: int, inner: bool = False) -> list[View]:
    """Views spread evenly over those of a split that count in its means and that every method has, by frame.

    Args:
        results: what was measured.
        split: whose views.
        count: how many at most.
        inner: leave the first and the last view out where others remain.
    """
    views = [
        image.view
        for image in results.methods[0].images
        if image.sampled
        and image.view.split == split
        and all(method.find(image.view) is not None for method in results.methods)
    ]
    views.sort(key=lambda view: (view.frame, view.camera))
    if not views:
        return []
    count = count + 2 if inner else min(count, len(views))
    picks = np.linspace(0, len(views) - 1, count).round().astype(int)
    return [views[i] for i in dict.fromkeys(picks[1:-1].tolist() if inner else picks.tolist())]


def truth_shot(capture: Capture, view: View) -> Shot:
    """The truth of a view, cut to the body."""
    image = capture.image(view.camera, view.frame)[body_window(capture, view)]
    return Shot("Truth", image, f"camera {view.camera}, frame {view.frame}")


def method_shots(results: Results, capture: Capture, pictures: Path, view: View) -> list[Shot]:
    """Each method's picture of a view, cut to the body, without errors."""
    window = body_window(capture, view)
    shots = []
    for method in results.methods:
        measured = method.find(view)
        psnr = tables.figure("box_psnr", measured.figures["box_psnr"] if measured else None)
        shots.append(Shot(method.label, read_picture(pictures / method.key, view)[window], f"{psnr} dB"))
    return shots


def _shots(results: Results, capture: Capture, pictures: Path, view: View) -> list[Shot]:
    truth = truth_shot(capture, view)
    shots = method_shots(results, capture, pictures, view)
    return [truth, *(replace(shot, error=absolute_error(truth.image, shot.image)) for shot in shots)]
