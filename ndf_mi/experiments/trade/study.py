"""The study of the trade: every point trained where it must be, drawn, held against truth and convergence, and timed, in one folder."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from PIL import Image

from ndf_mi import files, machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import choose_views
from ndf_mi.experiments.records import View
from ndf_mi.experiments.trade import points
from ndf_mi.experiments.trade.drawing import Drawing
from ndf_mi.experiments.trade.memory import peak_memory
from ndf_mi.experiments.trade.points import OWN, RUN, PathSetting, Point, Variant
from ndf_mi.experiments.trade.results import TRUTH, Figures, Row, Trade
from ndf_mi.experiments.trained import expect_options, read_options_of, trained
from ndf_mi.learn.loop import expect_capture
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.render.settings import Setting
from ndf_mi.reports.tradeoff import write_trade_report
from ndf_mi.run import Run
from ndf_mi.source_digest import code_digest, sources_digest

RESULTS = "tradeoff.json"
TABLE = "tradeoff.csv"
REPORT = "report.html"
PICTURES = "pictures"
#: Converged pictures as they are computed with.
CONVERGED = "converged"
FIELDS = "fields"
#: Steps of a training that ends by the clock: more than it will take.
UNLIMITED = 10**9

Told = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Settings:
    """How the trade is measured.

    Attributes:
        axes: what is turned, of `points.AXES`.
        steps: of each training; None trains by `seconds`.
        seconds: of each training, where `steps` is None.
        views: images of each held-out split that errors are measured on.
        timed: of these, how many are timed.
        repeats: times that every point is timed in each of them.
        path_size: longer side in pixels of path traced pictures.
        seed: of the choice of images and of the order in which points are timed.
    """

    axes: tuple[str, ...] = points.AXES
    steps: int | None = None
    seconds: float = 300.0
    views: int = 4
    timed: int = 2
    repeats: int = 5
    path_size: int = 48
    seed: int = 0

    def __post_init__(self) -> None:
        for axis in self.axes:
            if axis not in points.AXES:
                raise InputError("option only", repr(axis), "one of " + ", ".join(points.AXES))
        for key, least in (("steps", 1), ("views", 1), ("timed", 1), ("repeats", 1), ("path_size", 8), ("seed", 0)):
            if getattr(self, key) is not None and getattr(self, key) < least:
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), f"a whole number from {least} on")
        if not 0 < self.seconds < float("inf"):
            raise InputError("option seconds", f"{self.seconds:g}", "a time above 0")


class TradeStudy:
    """A study in one folder; :meth:`run` does what is still missing of it. What the folder holds of axes that are not asked for now stays,
    as long as it is of the same run, capture and views, and of trainings with the same options.

    Args:
        run: the run.
        capture: folder of the capture that it was trained on.
        folder: where `tradeoff.json`, `tradeoff.csv`, `report.html` and the trained fields go.
        settings: what is turned, and how it is measured.
        command: the command that the report says made it.

    Raises:
        InputError: run or capture can't be read, or don't belong together; the folder holds fields of other options.
    """

    def __init__(self, run: str | os.PathLike[str], capture: str | os.PathLike[str], folder: str | os.PathLike[str], settings: Settings,
                 command: str) -> None:
        self.folder = Path(folder)
        self._settings = settings
        self._run = Run.load(run)
        self._capture = Capture.read(capture)
        expect_capture(self._run, self._capture)
        views = [view for view in choose_views(self._capture, settings.views, settings.seed) if view.split != "train"]
        sources = code_digest() + sources_digest("plugins", "methods", "experiments/trade/paths.py", "render/settings.py")
        self._machine = machine.describe() | {"sources": hashlib.sha256(sources.encode()).hexdigest()[:12]}
        self._under = _name(self._machine)
        self._drawing = Drawing(self._capture, self.folder / CONVERGED / self._under, views, settings.timed, settings.path_size)
        self._drawing.fields[RUN] = self._run
        everything = self._all_variants()
        self._variants = [variant for variant in everything if variant.axis in (*settings.axes, OWN)]
        if not self._trains:
            self._variants = []
        self._others = [variant for variant in everything if variant not in self._variants and self._is_trained(variant)]
        for variant in self._variants:
            if (self._place(variant) / "config.json").exists():
                expect_options(Run.load(self._place(variant)), self._capture, variant.preset, variant.options)
        drawn = points.rendering_points(self._run.model.field.preset)
        self.points = [point for point in drawn if point.axis in (*settings.axes, "usual")] + self._of(self._variants)
        self._other_points = [point for point in drawn if point not in self.points] + self._of(self._others)
        self._rows: list[Row] = []
        known = Trade.read(self.folder / RESULTS) if (self.folder / RESULTS).exists() else Trade()
        self._known = {row.key: row for row in known.rows}
        self._sessions: dict[str, Any] = known.about.get("sessions", {})
        if "timing" in known.about:
            # Written before rows told what they were timed with: all of them at once.
            self._sessions = {_name(known.about["timing"]): known.about["timing"]}
            for row in known.rows:
                row.session = _name(known.about["timing"])
        self.trade = Trade(self._about(command, views))

    def run(self, tell: Told) -> Trade:
        """Does what is missing; table and report are written when all is there.

        Args:
            tell: told what is being done, and the number of it and of how many.

        Raises:
            KeyboardInterrupt: stopped; the same study goes on where it was.
        """
        for number, variant in enumerate(self._variants, start=1):
            def begin(number: int = number, variant: Variant = variant) -> None:
                tell(f"training {variant.label}", number, len(self._variants))

            self._drawing.fields[variant.key] = trained(self._place(variant), self._capture, variant.preset, variant.options, begin)
        self._rows = [self._row(point) for point in self.points]
        self.trade.rows = self._rows + self._kept()
        self.trade.about["paths"] = any(row.by_paths for row in self.trade.rows)
        for number, (point, row) in enumerate(zip(self.points, self._rows, strict=True), start=1):
            if row.under != self._under or not self._complete(row, point):
                tell(f"drawing {point.label}", number, len(self.points))
                self._measure(row, point)
                self._write()
            self._show_converged(row, point)
        self._time(tell)
        self.trade.write_csv(self.folder / TABLE)
        write_trade_report(self.folder / REPORT, self.trade, self._capture, self.folder)
        return self.trade

    def _of(self, variants: Sequence[Variant]) -> list[Point]:
        """The points that trained fields are: each drawn as usual."""
        setting = PathSetting() if self._drawing.scatters(self._run) else Setting()
        return [Point(v.key, v.axis, v.label, setting, v.key) for v in variants]

    @property
    def _trains(self) -> bool:
        return bool(set(self._settings.axes) & set(points.TRAINED))

    def _is_trained(self, variant: Variant) -> bool:
        """Whether the folder holds such a field, trained to its end: for as long as this call trains, if it does. It is then loaded."""
        if not (self._place(variant) / "config.json").exists():
            return False
        options = variant.options
        try:
            run = Run.load(self._place(variant))
            if not self._trains:
                known = read_options_of(run.config, str(run.path))[1]
                options = dataclasses.replace(options, steps=known["steps"], seconds=known["seconds"])
            expect_options(run, self._capture, variant.preset, options)
        except InputError:
            return False
        self._drawing.fields[variant.key] = run
        return bool(run.config.get("trained", {}).get("done"))

    def _kept(self) -> list[Row]:
        """Rows of points that are not asked for now, but were measured and timed before, and still hold."""
        rows = []
        for point in self._other_points:
            row = self._row(point)
            if row.seconds and self._complete(row, point):
                self._show_converged(row, point)
                rows.append(row)
        return rows

    def _all_variants(self) -> list[Variant]:
        known = self._run.config.get("training")
        where = f"{self._run.path / 'config.json'}: training"
        options = TrainingOptions.from_dict(known, where) if isinstance(known, dict) else TrainingOptions()
        if self._settings.steps is not None:
            options = dataclasses.replace(options, steps=self._settings.steps, seconds=0.0)
        else:
            options = dataclasses.replace(options, steps=UNLIMITED, seconds=self._settings.seconds)
        return points.variants_of(self._run.model.field.preset, options)

    def _place(self, variant: Variant) -> Path:
        return self.folder / FIELDS / variant.key

    def _row(self, point: Point) -> Row:
        """The row of a point in the results: what is known of it, or an empty one."""
        fingerprint = self._drawing.fingerprint(point)
        row = Row(point.key, point.axis, point.label, point.field, point.setting.to_dict(), point.by_paths, fingerprint)
        known = self._known.get(point.key)
        if known is not None and known.cache_key == fingerprint:
            row.figures, row.memory, row.metadata = known.figures, known.memory, known.metadata
            row.seconds, row.session, row.under = known.seconds, known.session, known.under
        return row

    def _complete(self, row: Row, point: Point) -> bool:
        views = self._drawing.views(point)
        return [f.view for f in row.figures] == views and all((self._picture(point.key, view)).is_file() for view in views)

    def _measure(self, row: Row, point: Point) -> None:
        row.figures, memory = [], 0
        # A scene that is loaded on the way would count as memory of the first point that needs it.
        row.metadata = self._facts(point)
        for view in self._drawing.views(point):
            picture, peak = peak_memory(lambda: self._drawing.draw(point, view))  # noqa: B023
            memory = max(memory, peak)
            reference, truth = self._drawing.converged(point, view), self._drawing.truth(point, view)
            mask = metrics.box_mask(self._drawing.camera(point, view), self._capture.poses.vertices[self._capture.poses.index(view.frame)])
            of_truth = {} if truth is None else metrics.measure(truth, picture, mask)
            figures = Figures(view, {key: of_truth[key] for key in TRUTH if key in of_truth},
                              metrics.psnr(reference, picture, mask) if mask.any() else None,
                              metrics.psnr(truth, reference, mask) if truth is not None and mask.any() else None)
            self._save(point.key, view, picture)
            row.figures.append(figures)
        row.memory, row.under = memory, self._under

    def _show_converged(self, row: Row, point: Point) -> None:
        """Saves what a point was held against, where it is not there yet."""
        for view in self._drawing.views(point):
            if not self._picture(row.reference, view).is_file():
                self._save(row.reference, view, self._drawing.converged(point, view))

    def _save(self, key: str, view: View, image: np.ndarray) -> None:
        with files.replacing(self._picture(key, view)) as beside:
            Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(beside)

    def _facts(self, point: Point) -> dict[str, Any]:
        run = self._drawing.fields[point.field]
        done = run.config.get("trained", {})
        return {"steps": done.get("steps"), "training_seconds": done.get("seconds"), "loading": self._drawing.loading(point),
                "parameters": sum(values.size for values in run.field_tensors().values())}

    def _picture(self, key: str, view: View) -> Path:
        return self.folder / PICTURES / key / view.file

    def _time(self, tell: Told) -> None:
        """Times every point once a repeat, all of them in one view after another, in an order drawn anew: what else the machine does, and
        what it does of itself, hits all alike. Kernels are compiled in a round before, which does not count."""
        conditions = {"machine": self._machine,
                      "points": [row.cache_key for row in self._rows], "timed": self._settings.timed}
        session = _name(conditions)
        if any(row.session != session for row in self._rows):
            for row in self._rows:
                row.seconds, row.session = [], session
        used = {row.session for row in self.trade.rows}
        self.trade.about["sessions"] = {name: of for name, of in (self._sessions | {session: conditions}).items() if name in used}
        self.trade.about["session"] = session
        done = min(len(row.seconds) for row in self._rows)
        for row in self._rows:
            row.seconds = row.seconds[:done]
        for repeat in range(done - 1, self._settings.repeats) if done < self._settings.repeats else ():
            warming = repeat < done
            tell("compiling" if warming else "timing", max(repeat + 1, 1), self._settings.repeats)
            taken = self._round(np.random.default_rng([self._settings.seed, repeat + 1]), seed=3 + max(repeat, 0))
            if not warming:
                for row, seconds in zip(self._rows, taken, strict=True):
                    row.seconds.append(float(np.mean(seconds)))
                self._write()

    def _round(self, rng: np.random.Generator, seed: int) -> list[list[float]]:
        """Seconds of each point in each of its timed views."""
        taken: list[list[float]] = [[] for _ in self.points]
        for turn in range(max(len(self._drawing.timed(point)) for point in self.points)):
            for index in rng.permutation(len(self.points)):
                point = self.points[index]
                if turn < len(self._drawing.timed(point)):
                    begun = time.perf_counter()
                    self._drawing.draw(point, self._drawing.timed(point)[turn], seed)
                    taken[index].append(time.perf_counter() - begun)
        return taken

    def _write(self) -> None:
        self.trade.write(self.folder / RESULTS)

    def _about(self, command: str, views: Sequence[View]) -> dict[str, Any]:
        camera = self._capture.cameras[views[0].camera]
        return {
            "run": {"path": str(self._run.path), "preset": self._run.model.field.preset.name, "digest": self._drawing.digest(RUN)},
            "capture": {"name": self._capture.name, "digest": self._capture.digest},
            "views": [structs.asdict(view) for view in views],
            "size": [camera.w, camera.h],
            "settings": asdict(self._settings) | {"axes": list(self._settings.axes)},
            "scatters": self._drawing.scatters(self._run),
            "lit": self._capture.lighting is not None,
            "sessions": self._sessions,
            "command": command,
            "machine": machine.describe(),
        }


def _name(conditions: dict[str, Any]) -> str:
    """A short name of the conditions that rows are timed in, all of them together."""
    return hashlib.sha256(json.dumps(conditions, sort_keys=True).encode()).hexdigest()[:12]
