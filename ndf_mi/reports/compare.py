"""The report of a comparison: figures, pictures, temporal consistency, training and how it was made."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ndf_mi.body.box import BOX_PADDING
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics, perceptual
from ndf_mi.experiments.records import SPLITS, Results
from ndf_mi.reports import page, tables, training
from ndf_mi.reports.advice import advice
from ndf_mi.reports.flicker import flicker_section
from ndf_mi.reports.page import Fact
from ndf_mi.reports.pictures import picture_rows
from ndf_mi.reports.tables import Table


def write_report(path: str | os.PathLike[str], results: Results, capture: Capture, pictures: Path) -> None:
    """Writes the report.

    Args:
        path: the HTML file.
        results: what was measured; differences refer to the first method.
        capture: the truth.
        pictures: a folder of pictures for each method, by its key.
    """
    about, shown = results.about, results.first()
    run = [Fact("Run", (about["run"],))] if about["run"] else []
    page.write_page(
        path, "compare.html.j2",
        name=capture.name,
        results=results,
        measured=[f"{about['measured'][split]} of {SPLITS[split]}" for split in results.splits()],
        protocol=page.protocol_sentence(about),
        cards=_cards(results),
        headline=headline(results, _held_out(results)),
        notes=[*notes(results), *training.equal_time_notes(shown)],
        rows=picture_rows(shown, capture, pictures),
        flicker=flicker_section(shown, capture, pictures),
        times=training.times(results),
        quality=training.quality(results),
        curves=training.curves(shown),
        advice=advice(results),
        full=[_full_table(results, split) for split in results.splits()],
        padding=100 * BOX_PADDING,
        origin=page.origin(
            about, *run, page.capture_fact(about), page.protocol_fact(about),
            Fact("Settings", (page.settings_text(about["settings"]),)),
            *map(training.metadata_fact, shown.methods)),
    )


def headline(results: Results, splits: Sequence[str]) -> Table:
    """The figures that the protocol puts first, on these splits; after box PSNR also that with matched
    colours, if a method was trained with a map of colour for each camera."""
    groups = [(SPLITS[split].capitalize(), results, split) for split in splits]
    keys = list(results.about["protocol"]["headline"])
    if any(method.mean(split, metrics.LPIPS) is not None for method in results.methods for split in splits):
        keys.append(metrics.LPIPS)
    if any(method.camera_colours for method in results.methods) and "box_psnr" in keys:
        keys.insert(keys.index("box_psnr") + 1, metrics.MATCHED)
    return tables.comparison(groups, keys)


def notes(results: Results) -> list[str]:
    """Sentences on differences to the protocol, on training, and on LPIPS where it is missing."""
    measured = any(method.mean(split, metrics.LPIPS) is not None
                   for method in results.methods for split in results.splits())
    absent = [] if measured else [perceptual.absence() or "LPIPS was not measured."]
    return [*page.protocol_notes(results.about), *training.notes(results), *absent]


def _held_out(results: Results) -> list[str]:
    return [split for split in results.splits() if split != "train"]


def _cards(results: Results) -> list[dict[str, Any]]:
    """The first method's figure on each held-out split, and how far it is from each other method."""
    first, *others = results.trainings()
    cards = []
    for split in (split for split in _held_out(results) if split != "sequence"):
        mine = first.mean(split, "box_psnr")
        gains = [(other, tables.difference(mine, other.mean(split, "box_psnr"))) for other in others]
        lines = [
            f"{tables.signed('box_psnr', gain)} dB compared with {tables.named(other.label)}"
            for other, gain in gains
        ]
        value = tables.figure("box_psnr", mine)
        cards.append({"title": f"{first.label}, {SPLITS[split]}", "value": value, "differences": lines})
    return cards


def _full_table(results: Results, split: str) -> Table:
    pairs = sum(len(known.tpsnr) for known in results.methods[0].flicker if known.sequence.split == split)
    images = tables.count(results.about["measured"][split], "image")
    caption = f"{SPLITS[split].capitalize()}, means over {images}"
    caption += f"; tPSNR over {tables.count(pairs, 'pair')} of frames" if pairs else ""
    # Comparisons of older versions did not match colours, and not everybody has LPIPS.
    unknown = [key for key in (metrics.MATCHED, metrics.LPIPS)
               if all(method.mean(split, key) is None for method in results.methods)]
    keys = [key for key in metrics.LABELS if key not in unknown]
    return tables.comparison([("", results, split)], keys, caption)
