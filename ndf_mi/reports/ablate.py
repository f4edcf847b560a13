"""The report of an ablation study: what each part is worth, compared with the published figures."""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass
from pathlib import Path

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.records import HELD_OUT, SPLITS, MethodResult, Results
from ndf_mi.learn.ablations import ABLATIONS
from ndf_mi.reports import page, tables
from ndf_mi.reports.page import Fact
from ndf_mi.reports.pictures import PictureRow, method_shots, spread, truth_shot, view_row
from ndf_mi.reports.tables import Cell, Row, Table

#: PSNR in dB on ZJU-MoCap 313, novel views and novel poses (Zhang and Chen 2022, the table of ablations).
PAPER = {
    "full": (29.75, 23.41),
    "naked": (23.65, 21.71),
    "no-pose": (21.98, 20.43),
    "no-projection": (29.73, 18.42),
    "no-deform": (29.72, 23.35),
    "one-piece": (29.93, 23.38),
}
#: Differences up to this many dB count as none. The paper calls rows level that differ by up to 0.18 dB.
LEVEL = 0.25
#: Splits in the table, where the capture has them.
SHOWN = (*HELD_OUT, "sequence")
METRICS = {"box_psnr": "PSNR", "box_ssim": "SSIM", "box_tpsnr": "tPSNR"}
#: Views of each split that are shown.
VIEWS = 2


@dataclass(frozen=True)
class Agreement:
    """A variant's difference to the full model in box PSNR (dB) on one split, here and in the paper."""

    here: float
    paper: float

    @property
    def agrees(self) -> bool:
        """Whether both put the variant behind the full model, both level with it, or both ahead of it."""
        here, paper = (0 if abs(gap) <= LEVEL else math.copysign(1, gap) for gap in (self.here, self.paper))
        return here == paper


def agreement(results: Results, name: str, split: str) -> Agreement | None:
    """A variant's differences to the full model on a split; None if one of the figures is missing."""
    variant = results.method(name)
    here = None if variant is None else _to_full(results, variant, split)
    if split not in HELD_OUT or name not in PAPER or here is None:
        return None
    column = HELD_OUT.index(split)
    return Agreement(here, PAPER[name][column] - PAPER["full"][column])


def order(results: Results, split: str) -> tuple[int, int] | None:
    """How many of the pairs that the paper separates by more than `LEVEL` are in its order, and their number.

    None where there are no such pairs.
    """
    if split not in HELD_OUT:
        return None
    column = HELD_OUT.index(split)
    here = {method.key: method.mean(split, "box_psnr") for method in results.methods if method.key in PAPER}
    paper = {key: PAPER[key][column] for key in here}
    pairs = [
        (found, paper[a] - paper[b])
        for a, b in itertools.combinations(here, 2)
        if abs(paper[a] - paper[b]) > LEVEL and (found := tables.difference(here[a], here[b])) is not None
    ]
    return (sum(a * b > 0 for a, b in pairs), len(pairs)) if pairs else None


def table(results: Results) -> Table:
    """Figures of each variant on each split, and its difference to the full model here and in the paper."""
    splits = _splits(results)
    columns = (*METRICS.values(), "compared with full", "in the paper")
    rows = []
    for method in results.methods:
        cells, agreed = [], []
        for split in splits:
            found = agreement(results, method.key, split)
            cells += [tables.figure(key, method.mean(split, key)) for key in METRICS]
            both = (_to_full(results, method, split), None if found is None else found.paper)
            cells += ["" if value is None else tables.signed("box_psnr", value) for value in both]
            agreed += [] if found is None else ["yes" if found.agrees else "no"]
        rows.append(Row(method.label, tuple(map(Cell, [*cells, " / ".join(agreed)]))))
    groups = [(SPLITS[split].capitalize(), len(columns)) for split in splits]
    return Table((*columns * len(splits), "agrees"), tuple(rows), (*groups, ("", 1)), corner="Variant")


def markdown(results: Results) -> str:
    """The table and its notes in Markdown."""
    notes = [*_orders(results), *page.protocol_notes(results.about)]
    return "\n".join([table(results).markdown(), *notes]) + "\n"


def write_ablation_report(
    path: str | os.PathLike[str], results: Results, capture: Capture, pictures: Path
) -> None:
    """Writes the HTML file, and `table.md` next to it; arguments as of `reports.compare.write_report`."""
    about = results.about
    measured = ", ".join(f"{number} of {SPLITS[split]}" for split, number in about["measured"].items())
    page.write_page(
        path, "ablate.html.j2",
        name=capture.name,
        level=LEVEL,
        table=table(results),
        notes=[*_orders(results), *page.protocol_notes(about)],
        rows={split: _rows(results, split, capture, pictures) for split in _splits(results)},
        labels=SPLITS,
        variants=[Fact(method.label, (_variant(method),)) for method in results.methods],
        origin=page.origin(
            about, page.capture_fact(about), page.protocol_fact(about), Fact("Images measured", (measured,)),
            Fact("Training", (page.settings_text(about["training"]),))),
    )
    files.write_text(Path(path).with_name("table.md"), markdown(results))


def _to_full(results: Results, method: MethodResult, split: str) -> float | None:
    full = results.method("full")
    if full is None or method.key == "full":
        return None
    return tables.difference(method.mean(split, "box_psnr"), full.mean(split, "box_psnr"))


def _splits(results: Results) -> list[str]:
    return [split for split in SHOWN if split in results.splits()]


def _orders(results: Results) -> list[str]:
    """A sentence for each split on the order of the variants."""
    found = [(SPLITS[split].capitalize(), order(results, split)) for split in _splits(results)]
    return [
        f"{split}: {known[0]} of {tables.count(known[1], 'pair')} of variants in the paper’s order, "
        f"counting the pairs that the paper separates by more than {LEVEL} dB."
        for split, known in found if known is not None
    ]


def _rows(results: Results, split: str, capture: Capture, pictures: Path) -> list[PictureRow]:
    views = spread(results, split, VIEWS, inner=True)
    shots = ([truth_shot(capture, view), *method_shots(results, capture, pictures, view)] for view in views)
    return [view_row(row, view) for row, view in zip(shots, views, strict=True)]


def _variant(method: MethodResult) -> str:
    """What a variant changes, and how long it took."""
    parts = [ABLATIONS[method.key].meaning] if method.key in ABLATIONS else []
    if method.metadata.get("steps"):
        training = tables.duration(method.metadata.get("seconds"))
        rendering = tables.duration(method.seconds_an_image())
        parts.append(f"{method.metadata['steps']:,} training steps in {training}, {rendering} per image")
    return "; ".join(parts) or "–"
