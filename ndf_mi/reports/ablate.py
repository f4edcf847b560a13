"""The ablation study's table and page: what each part is worth here, beside what the paper found."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from PIL import Image

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS
from ndf_mi.experiments.records import Results, View
from ndf_mi.learn.ablations import ABLATIONS
from ndf_mi.reports import tables
from ndf_mi.reports.pictures import data_uri
from ndf_mi.reports.style import CSS

#: PSNR in dB on ZJU-MoCap 313, novel views and novel poses (Zhang and Chen 2022, the table of ablations).
PAPER = {
    "full": (29.75, 23.41), "naked": (23.65, 21.71), "no-pose": (21.98, 20.43), "no-projection": (29.73, 18.42),
    "no-deform": (29.72, 23.35), "one-piece": (29.93, 23.38),
}
HELD_OUT = ("novel_view", "novel_pose")
#: Differences up to this many dB count as none. The paper's table has up to 0.18 dB between rows that its text calls level.
SAME = 0.25
#: What the table tells: the paper's splits, and the successive frames where the capture has them.
TOLD = (*HELD_OUT, "sequence")
METRICS = ("box_psnr", "box_ssim", "box_tpsnr")
_VIEWS = 2


@dataclass(frozen=True)
class Agreement:
    """How far a variant is from the full model in box PSNR on one split, here and in the paper, and whether both say the same."""

    here: float
    paper: float

    @property
    def agrees(self) -> bool:
        """Whether both are behind the full model, both level with it to within `SAME`, or both ahead of it."""
        return _side(self.here) == _side(self.paper)


def agreement(results: Results, name: str, split: str) -> Agreement | None:
    """The variant's standing on a split; None where it, the full model or the paper's figure is missing."""
    full, variant = results.method("full"), results.method(name)
    if split not in HELD_OUT or name == "full" or name not in PAPER or full is None or variant is None:
        return None
    here = tables.difference(variant.mean(split, "box_psnr"), full.mean(split, "box_psnr"))
    column = HELD_OUT.index(split)
    return None if here is None else Agreement(here, PAPER[name][column] - PAPER["full"][column])


def order(results: Results, split: str) -> tuple[int, int] | None:
    """Of the pairs of variants that are further apart than `SAME` in the paper, how many stand in the same order here; and how many
    pairs there are. None where there are none."""
    if split not in HELD_OUT:
        return None
    known = {m.key: m.mean(split, "box_psnr") for m in results.methods if m.key in PAPER}
    column = HELD_OUT.index(split)
    pairs = [(a, b) for a, b in itertools.combinations(known, 2) if abs(PAPER[a][column] - PAPER[b][column]) > SAME]
    differences = [(tables.difference(known[a], known[b]), PAPER[a][column] - PAPER[b][column]) for a, b in pairs]
    told = [(here, paper) for here, paper in differences if here is not None]
    return (sum(here * paper > 0 for here, paper in told), len(told)) if told else None


def markdown(results: Results) -> str:
    """The table in Markdown: box PSNR and SSIM and temporal PSNR on every split, the distance from the full model, and the paper's."""
    heads = ["", *(f"{LABELS[split]}: {text}" for split in _splits(results) for text in ("PSNR", "SSIM", "tPSNR", "to full", "paper's")),
             "agrees"]
    lines = ["| " + " | ".join(heads) + " |", "| --- |" + " --- |" * (len(heads) - 1)]
    lines += ["| " + " | ".join(row) + " |" for row in _rows(results)]
    lines += ["", *_orders(results), *tables.protocol_notes(results)]
    return "\n".join(lines) + "\n"


def write_ablation_report(path: str | os.PathLike[str], results: Results, capture: Capture, pictures: Path) -> None:
    """Writes the page, and `table.md` beside it.

    Args:
        path: the HTML file.
        results: what was measured of each variant.
        capture: the truth of the pictures.
        pictures: the folder that `evaluate` wrote to, one folder a variant.
    """
    name = escape(capture.name)
    heads = "".join(f'<th class="group" colspan="5">{LABELS[split].capitalize()}</th>' for split in _splits(results))
    columns = "".join(f"<th>{text}</th>" for text in ("PSNR", "SSIM", "tPSNR", "to full", "paper’s")) * len(_splits(results))
    body = "".join("<tr>" + f'<th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:]) + "</tr>"
                   for row in _rows(results))
    meanings = "".join(f"<tr><th>{escape(m.label)}</th><td>{escape(ABLATIONS[m.key].meaning)}; {m.metadata['steps']:,} steps in "
                       f"{tables.duration(m.metadata['seconds'])}, {tables.duration(m.seconds_an_image())} an image</td></tr>"
                       for m in results.methods if m.metadata.get("steps"))
    page = (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{name}: ablations</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{CSS}</style>\n</head>\n<body>\n'
        f"<h1>What each part is worth on “{name}”</h1>\n"
        f'<p class="soft">Box PSNR and temporal PSNR in dB; “to full” is the difference to the full model here, “paper’s” the same '
        f"difference in the paper’s table, on another capture. They agree where both are behind, both ahead, or both within {SAME} dB."
        "</p>\n"
        f'<div class="scroll"><table><thead><tr><th></th>{heads}<th></th></tr><tr><th></th>{columns}<th>agrees</th></tr></thead>'
        f"<tbody>{body}</tbody></table></div>\n{_paragraphs(_orders(results))}"
        f"{_paragraphs(tables.protocol_notes(results))}\n"
        f"<h2>Pictures</h2>\n{_pictures(results, capture, pictures)}\n"
        f'<h2>Variants</h2>\n<table class="facts"><tbody>{meanings}</tbody></table>\n'
        f'<h2>How it was made</h2>\n<pre>{escape(results.about["command"])}</pre>\n'
        f'<table class="facts"><tbody>{_facts(results)}</tbody></table>\n</body>\n</html>\n'
    )
    files.write_text(path, page)
    files.write_text(Path(path).with_name("table.md"), markdown(results))


def _side(difference: float) -> int:
    return 0 if abs(difference) <= SAME else (1 if difference > 0 else -1)


def _splits(results: Results) -> list[str]:
    return [split for split in TOLD if split in results.splits()]


def _rows(results: Results) -> list[list[str]]:
    table = []
    for method in results.methods:
        row, agreed = [method.label], []
        for split in _splits(results):
            row += [tables.figure(key, method.mean(split, key)) for key in METRICS]
            found = agreement(results, method.key, split)
            full = results.method("full")
            here = None if method.key == "full" or full is None else tables.difference(
                method.mean(split, "box_psnr"), full.mean(split, "box_psnr"))
            paper = None if found is None else found.paper
            row += ["" if value is None else tables.signed("box_psnr", value) for value in (here, paper)]
            if found is not None:
                agreed.append(f"{'yes' if found.agrees else 'no'}")
        table.append([*row, " / ".join(agreed)])
    return table


def _orders(results: Results) -> list[str]:
    """A sentence a split on the order of the rows."""
    found = {split: order(results, split) for split in _splits(results)}
    return [f"{LABELS[split].capitalize()}: {same} of {pairs} pairs of rows that the paper tells apart are in the paper's order."
            for split, (same, pairs) in ((split, pair) for split, pair in found.items() if pair is not None)]


def _paragraphs(lines: Sequence[str]) -> str:
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _facts(results: Results) -> str:
    about = results.about
    training = ", ".join(f"{key} {value}" for key, value in about["training"].items())
    facts = {"Capture": f"{about['capture']['name']}, digest {about['capture']['digest'][:16]}…", **about["machine"],
             "Protocol": tables.protocol_sentence(results),
             "Measured": ", ".join(f"{count} of {LABELS[split]}" for split, count in about["measured"].items()), "Training": training}
    return "".join(f"<tr><th>{escape(key)}</th><td>{escape(str(value))}</td></tr>" for key, value in facts.items())


def _pictures(results: Results, capture: Capture, pictures: Path) -> str:
    """A row of the truth and every variant for views of each held-out split."""
    parts = []
    for split in _splits(results):
        parts.append(f"<h3>{LABELS[split].capitalize()}</h3>")
        for view in _chosen(results, split):
            cells = [f'<div class="head">{escape(text)}</div>' for text in ("Truth", *(m.label for m in results.methods))]
            cells.append(_figure(_cut(capture, view, capture.image(view.camera, view.frame)), f"camera {view.camera}, frame {view.frame}"))
            for method in results.methods:
                with Image.open(pictures / method.key / view.file) as picture:
                    image = np.asarray(picture.convert("RGB"), dtype=np.float32) / 255
                measured = method.find(view)
                psnr = "" if measured is None else tables.figure("box_psnr", measured.figures["box_psnr"]) + " dB"
                cells.append(_figure(_cut(capture, view, image), psnr))
            parts.append(f'<div class="row" style="grid-template-columns: repeat({len(cells) // 2}, 1fr)">{"".join(cells)}</div>')
    return "\n".join(parts)


def _chosen(results: Results, split: str) -> Sequence[View]:
    """Views spread evenly over those that every variant has, by frame."""
    views = [image.view for image in results.methods[0].images if image.view.split == split and image.sampled]
    views = sorted((view for view in views if all(method.find(view) for method in results.methods)), key=lambda v: (v.frame, v.camera))
    picks = np.linspace(0, max(len(views) - 1, 0), _VIEWS + 2).round().astype(int)[1:-1]
    return [views[i] for i in dict.fromkeys(picks.tolist())] if views else []


def _cut(capture: Capture, view: View, image: np.ndarray) -> np.ndarray:
    mask = metrics.box_mask(capture.cameras[view.camera], capture.poses.vertices[capture.poses.index(view.frame)])
    rectangle = metrics.bounding_rectangle(mask)
    return image if rectangle is None else image[rectangle]


def _figure(image: np.ndarray, caption: str) -> str:
    return f'<figure><img src="{data_uri(image)}" alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
