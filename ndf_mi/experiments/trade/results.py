"""`tradeoff.json` and `tradeoff.csv`: what was measured of each point of the trade."""

from __future__ import annotations

import csv
import io
import json
import os
import statistics
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import asdict

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import View

FORMAT = "ndf-tradeoff"
VERSION = 1
#: Figures against the truth.
TRUTH = ("box_psnr", "box_ssim", "box_flip")


class Figures(Struct):
    """Errors of one point in one view; None where not defined, infinite PSNR where there is no error.

    Attributes:
        view: which.
        truth: against the capture's image, by the keys `TRUTH`; empty where the picture is not meant to show what the capture does.
        converged: box PSNR in dB against the same field drawn to convergence.
        model: box PSNR in dB of that converged picture against the capture's image.
    """

    view: View
    truth: dict[str, float | None]
    converged: float | None
    model: float | None


class Row(Struct):
    """What is known of one point.

    Attributes:
        key, axis, label, field: the point's.
        setting: how it is drawn, JSON values.
        by_paths: whether it is path traced, which shows another picture and has a front of its own.
        cache_key: of field, setting and views; a changed one makes the figures void.
        metadata: JSON values; of a trained field `steps` and `training_seconds`, of a path traced one `loading` in seconds a frame.
        memory: peak in bytes, as `memory.MEANING` says.
        figures: a view each.
        seconds: a frame, of each repeat the mean over the views timed.
        session: what it was timed with, of the study's `sessions`: rows of one session were timed in turns.
        under: a digest of machine, versions, variant and sources that figures, memory and facts were measured under; "" where not known.
    """

    key: str
    axis: str
    label: str
    field: str
    setting: dict[str, Any]
    by_paths: bool
    cache_key: str
    metadata: dict[str, Any] = {}
    memory: int | None = None
    figures: list[Figures] = []
    seconds: list[float] = []
    session: str = ""
    under: str = ""

    @property
    def reference(self) -> str:
        """The folder of the pictures that it is held against: of its field drawn to convergence, with as many rays a pixel."""
        return reference_of(self.field, None if self.by_paths else self.setting["spp"])

    @property
    def frame_seconds(self) -> float | None:
        """The median over the repeats."""
        return statistics.median(self.seconds) if self.seconds else None

    def truth(self, metric: str = "box_psnr") -> float | None:
        """The mean over the views of a figure against the truth; None where there is none."""
        return metrics.average([figures.truth.get(metric) for figures in self.figures])

    def converged(self) -> float | None:
        """The mean over the views of the PSNR against convergence."""
        return metrics.average([figures.converged for figures in self.figures])

    def model(self) -> float | None:
        """The mean over the views of the PSNR that the converged field has against the truth."""
        return metrics.average([figures.model for figures in self.figures])


def reference_of(field: str, spp: int | None) -> str:
    """The folder of a field's converged pictures with so many rays a pixel; None for those by paths."""
    return f"{field}-converged-{'path' if spp is None else spp}"


class Trade(Struct):
    """The whole study: `about` holds what the report says of it."""

    about: dict[str, Any] = {}
    rows: list[Row] = []

    def row(self, key: str) -> Row | None:
        """The row of a point, or None."""
        return next((row for row in self.rows if row.key == key), None)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes `tradeoff.json`, whole or not at all."""
        files.write_json(path, {"format": FORMAT, "version": VERSION, "about": self.about, "points": [_to_json(row) for row in self.rows]})

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Trade:
        """Reads `tradeoff.json`.

        Raises:
            InputError: the file is missing, is not such a file, or is of another version.
        """
        expected = f"a {FORMAT} file of version {VERSION}"
        try:
            document = json.loads(Path(path).read_text(encoding="utf-8"))
            found = (document["format"], document["version"])
            trade = cls(document["about"], [_from_json(entry) for entry in document["points"]]) if found == (FORMAT, VERSION) else cls()
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(path, f"a file that can't be read ({error!r})", expected, "Remove it.") from error
        if found != (FORMAT, VERSION):
            raise InputError(path, f"format {found[0]!r} of version {found[1]!r}", expected, "Remove it.")
        return trade

    def write_csv(self, path: str | os.PathLike[str]) -> None:
        """Writes a line a point: everything that can be turned, then everything that was measured, means over the views."""
        turned = list(dict.fromkeys(key for row in self.rows for key in row.setting))
        stream = io.StringIO()
        sheet = csv.writer(stream, lineterminator="\n")
        sheet.writerow(["point", "axis", "label", "field", "integrator", *turned, "seconds_a_frame", "seconds_least", "seconds_most",
                        "repeats", "session", "loading_seconds", "training_seconds", "training_steps", "peak_bytes", *TRUTH,
                        "converged_box_psnr", "model_box_psnr"])
        for row in self.rows:
            cells = [row.key, row.axis, row.label, row.field, "volpath" if row.by_paths else "quadrature",
                     *(row.setting.get(key) for key in turned), row.frame_seconds, min(row.seconds, default=None),
                     max(row.seconds, default=None), len(row.seconds), row.session, row.metadata.get("loading"),
                     row.metadata.get("training_seconds"), row.metadata.get("steps"),
                     row.memory, *(row.truth(key) for key in TRUTH), row.converged(), row.model()]
            sheet.writerow(["" if cell is None else cell for cell in cells])
        files.write_text(path, stream.getvalue())


def _to_json(row: Row) -> dict[str, Any]:
    figures = [{"view": asdict(f.view), "truth": {key: metrics.to_json(value) for key, value in f.truth.items()},
                "converged": metrics.to_json(f.converged), "model": metrics.to_json(f.model)} for f in row.figures]
    means = {**{key: metrics.to_json(row.truth(key)) for key in TRUTH}, "converged": metrics.to_json(row.converged()),
             "model": metrics.to_json(row.model()), "seconds": row.frame_seconds}
    return {**{key: getattr(row, key) for key in ("key", "axis", "label", "field", "setting", "by_paths", "memory", "seconds", "session",
                                                  "under")},
            "fingerprint": row.cache_key, "facts": row.metadata, "means": means, "figures": figures}


def _from_json(document: dict[str, Any]) -> Row:
    figures = [Figures(View(**entry["view"]), {key: metrics.from_json(value) for key, value in entry["truth"].items()},
                       metrics.from_json(entry["converged"]), metrics.from_json(entry["model"])) for entry in document["figures"]]
    return Row(document["key"], document["axis"], document["label"], document["field"], document["setting"], document["by_paths"],
               document["fingerprint"], document["facts"], document["memory"], figures, list(document["seconds"]),
               document.get("session", ""), document.get("under", ""))
