"""The report on relighting: one table for all lights, and pictures under each."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.records import SPLITS, Results
from ndf_mi.reports import page, tables, training
from ndf_mi.reports.page import Fact
from ndf_mi.reports.pictures import picture_rows
from ndf_mi.reports.tables import Table

METRICS = ("box_psnr", "box_ssim")


def write_relight_report(
    path: str | os.PathLike[str], results: Mapping[str, Results], captures: Mapping[str, Capture],
    pictures: Mapping[str, Path],
) -> None:
    """Writes the report of a finished relighting as one HTML file.

    Args:
        path: the HTML file.
        results: what was measured under each light, by the light's name; training used the first one.
        captures: the truth under each light.
        pictures: under each light, a folder that holds a folder of pictures for each method, by its key.
    """
    seen, *unseen = results
    about = results[seen].about
    page.write_page(
        path, "relight.html.j2",
        name=captures[seen].name,
        seen=about["capture"]["path"],
        unseen=[results[light].about["capture"]["path"] for light in unseen],
        table=table(results),
        notes=notes(results),
        lights={
            f"Under the {light} light": picture_rows(results[light], captures[light], pictures[light])
            for light in results
        },
        origin=page.origin(about, Fact("Run", (about["run"],))),
    )


def table(results: Mapping[str, Results]) -> Table:
    """The figures under each light on each split."""
    groups = [
        (f"{light.capitalize()} light, {SPLITS[split]}", measured, split)
        for light, measured in results.items() for split in measured.splits()
    ]
    return tables.comparison(groups, METRICS)


def notes(results: Mapping[str, Results]) -> list[str]:
    """Sentences on the noise of the pictures, the grid that the field is shown on, and training."""
    noise = [
        f"{method.label} {method.metadata['noise_psnr']:.1f} dB under the {light} light"
        for light, measured in results.items()
        for method in measured.methods
        if method.metadata.get("noise_psnr") is not None
    ]
    first = next(iter(results.values()))
    settings = first.about["settings"]
    spacing = settings.get("grid_spacing", settings.get("lattice", 0.0))
    lines = [f"PSNR of the pictures’ noise alone, in the box: {', '.join(noise)}."] if noise else []
    if spacing:
        lines.append(f"The field is interpolated on a grid of {1000 * spacing:g} mm, as in training.")
    return lines + training.notes(first)
