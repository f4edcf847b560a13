"""The study of the trade of speed for accuracy: its points are trained, rendered, measured and timed."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from msgspec import structs

from ndf_mi import machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.core import SILENT, Progress, Unit, run_units
from ndf_mi.experiments.evaluate import held_out_views, save_picture
from ndf_mi.experiments.fit import training_unit
from ndf_mi.experiments.records import Trained, View
from ndf_mi.experiments.settings import at_least, positive
from ndf_mi.experiments.store import Store
from ndf_mi.experiments.trade import points
from ndf_mi.experiments.trade.memory import peak_memory
from ndf_mi.experiments.trade.points import OWN, RUN, PathSetting, Point, Variant
from ndf_mi.experiments.trade.rendering import Renderings, training_of
from ndf_mi.experiments.trade.results import TRUTH, Drawn, Figures, Row, Timing, Trade
from ndf_mi.experiments.trade.timing import Session, digest_of, read_timings, seconds_of
from ndf_mi.learn.loop import expect_capture
from ndf_mi.learn.trained import expect_options, is_trained, read_options
from ndf_mi.render.settings import Setting
from ndf_mi.run import Run
from ndf_mi.source_digest import code_digest, sources_digest

RESULTS = "tradeoff.json"
TABLE = "tradeoff.csv"
PICTURES = "pictures"
CONVERGED = "converged"
"""Folder of converged pictures in full precision."""
FIELDS = "fields"
UNLIMITED = 10**9
"""Steps of a training that ends by the clock."""


@dataclass(frozen=True)
class Settings:
    """How the trade is measured.

    Attributes:
        axes: what is varied, of `points.AXES`.
        steps: steps of each training; None trains for `seconds`.
        seconds: time of each training where `steps` is None.
        views: images of each held-out split that errors are measured on.
        timed: how many of these views are timed.
        repeats: how often every point is timed in each of them.
        path_size: longer side in pixels of path-traced pictures.
        seed: seed of the choice of images and of the order of timing.
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
        at_least(self, steps=1, views=1, timed=1, repeats=1, path_size=8, seed=0)
        positive(self, "seconds")

    @property
    def trains(self) -> bool:
        """Whether fields are trained."""
        return bool(set(self.axes) & set(points.TRAINED))


class TradeStudy:
    """A study in one folder. Measurements of axes that are not asked for now stay in its table, as long as
    they are of the same run, capture and views, and of trainings with the same options.

    Args:
        run: folder of the run.
        capture: folder of the capture that it was trained on.
        folder: where `tradeoff.json`, `tradeoff.csv`, pictures and trained fields go.
        settings: what is varied, and how it is measured.
        command: the command that the report names.

    Raises:
        InputError: run or capture cannot be read or do not belong together, or the folder holds fields with
            other options.
    """

    def __init__(
        self, run: str | os.PathLike[str], capture: str | os.PathLike[str], folder: str | os.PathLike[str],
        settings: Settings, command: str,
    ) -> None:
        self.folder = Path(folder)
        self.settings = settings
        self._run = Run.load(run)
        self.capture = Capture.read(capture)
        expect_capture(self._run, self.capture)
        views = held_out_views(self.capture, settings.views, settings.seed)
        rendering = ("plugins", "methods", "experiments/trade/paths.py", "render/settings.py")
        sources = code_digest() + sources_digest(*rendering)
        self._machine = machine.describe() | {"sources": hashlib.sha256(sources.encode()).hexdigest()[:12]}
        # What figures and memory depend on besides the point itself.
        self._environment = digest_of(self._machine)
        converged = self.folder / CONVERGED / self._environment
        self._renderings = Renderings(self.capture, converged, views, settings.timed, settings.path_size)
        self._renderings.fields[RUN] = self._run
        everything = self._all_variants()
        trained = (*settings.axes, OWN) if settings.trains else ()
        self._variants = [variant for variant in everything if variant.axis in trained]
        others = [v for v in everything if v not in self._variants and self._load_trained(v)]
        for variant in self._variants:
            if (self._place(variant) / "config.json").exists():
                expect_options(Run.load(self._place(variant)), self.capture, variant.preset, variant.options)
        rendered = points.rendering_points(self._run.model.field.preset)
        self.points = [point for point in rendered if point.axis in (*settings.axes, "usual")]
        self._other_points = [point for point in rendered if point not in self.points]
        self.points += self._points_of(self._variants)
        self._other_points += self._points_of(others)
        self._store = Store(self.folder / RESULTS, "tradeoff")
        self.trade = Trade(self._about(command, views))

    def run(self, progress: Progress = SILENT) -> Trade:
        """Does what is missing or stale.

        Raises:
            KeyboardInterrupt: stopped; the same study continues where it stopped.
        """
        self._store.about, self._store.summary = self.trade.about, self.trade.summary
        run_units([self._training(variant) for variant in self._variants], self._store, progress)
        self._renderings.fields |= {variant.key: Run.load(self._place(variant)) for variant in self._variants}
        run_units([self._unit(point) for point in self.points], self._store, progress)
        how = self._machine, self.settings.timed, self.settings.seed
        session = Session(self.points, self._renderings, *how)
        run_units(session.units(self.settings.repeats), self._store, progress)
        self._fill(session.name)
        for row in self.trade.rows:
            self._show_converged(row)
        self._store.write()
        self.trade.write_csv(self.folder / TABLE)
        return self.trade

    def _fill(self, session: str) -> None:
        """Makes the rows: those of this call, then those of earlier calls that are complete."""
        timings = read_timings(self._store)
        rows = [self._row(point, timings, session) for point in self.points]
        rows += [self._row(point, timings) for point in self._other_points if self._drawn(point)]
        self.trade.rows = [row for row in rows if row.seconds]
        used = {row.session for row in self.trade.rows}
        self.trade.about["sessions"] = {
            name: {"machine": repeats[0].machine, "timed": repeats[0].timed}
            for name, repeats in timings.items()
            if name in used
        }
        self.trade.about["session"] = session
        self.trade.about["paths"] = any(row.by_paths for row in self.trade.rows)

    def _row(self, point: Point, timings: Mapping[str, list[Timing]], session: str | None = None) -> Row:
        drawn = self._drawn(point)
        assert drawn is not None
        cache_key = self._renderings.cache_key(point)
        name, seconds = seconds_of(timings, point.key, cache_key, session)
        repeats = self.settings.repeats if session else None
        return Row(
            point.key, point.axis, point.label, point.field, point.setting.to_dict(), point.by_paths,
            cache_key, drawn.metadata, drawn.memory, drawn.figures, seconds[:repeats], name,
        )

    def _drawn(self, point: Point) -> Drawn | None:
        """What was measured of a point, on whatever machine, or None."""
        unit = self._unit(point)
        environment = self._store.inputs(unit.key).get("environment")
        inputs = {**unit.inputs, "environment": environment}
        return self._store.fresh(dataclasses.replace(unit, inputs=inputs))

    def _training(self, variant: Variant) -> Unit[Trained]:
        key, label = f"fields/{variant.key}", f"train {variant.label}"
        return training_unit(key, label, self._place(variant), self.capture, variant.preset, variant.options)

    def _unit(self, point: Point) -> Unit[Drawn]:
        """Rendering and measuring a point."""
        pictures = tuple(self._picture(point.key, view) for view in self._renderings.views(point))
        inputs = {"images": self._renderings.cache_key(point), "environment": self._environment}
        work = partial(self._measure, point)
        return Unit(f"draw/{point.key}", inputs, work, Drawn, pictures, f"render {point.label}", "render")

    def _measure(self, point: Point) -> Drawn:
        # First, because a scene that is loaded later would count as memory of this point.
        metadata = self._metadata(point)
        figures, memory = [], 0
        for view in self._renderings.views(point):
            picture, peak = peak_memory(lambda: self._renderings.draw(point, view))  # noqa: B023
            memory = max(memory, peak)
            converged, truth = self._renderings.converged(point, view), self._renderings.truth(point, view)
            camera = self._renderings.camera(point, view)
            mask = metrics.box_mask(camera, self.capture.poses.vertices[self.capture.poses.index(view.frame)])
            found = Figures(view, {}, None, None)
            if mask.any():
                found.converged = metrics.psnr(converged, picture, mask)
            if truth is not None:
                measured = metrics.measure(truth, picture, mask)
                found.truth = {key: measured[key] for key in TRUTH}
                found.model = metrics.psnr(truth, converged, mask) if mask.any() else None
            figures.append(found)
            save_picture(self._picture(point.key, view), picture)
        return Drawn(figures, memory, metadata)

    def _show_converged(self, row: Row) -> None:
        """Saves the pictures that a point is compared with, where they are missing."""
        point = next(point for point in [*self.points, *self._other_points] if point.key == row.key)
        for view in self._renderings.views(point):
            if not self._picture(row.reference, view).is_file():
                save_picture(self._picture(row.reference, view), self._renderings.converged(point, view))

    def _metadata(self, point: Point) -> dict[str, Any]:
        run = self._renderings.fields[point.field]
        done = run.config.get("trained", {})
        return {
            "steps": done.get("steps"), "training_seconds": done.get("seconds"),
            "loading": self._renderings.loading(point),
            "parameters": sum(values.size for values in run.field_tensors().values()),
        }

    def _picture(self, key: str, view: View) -> Path:
        return self.folder / PICTURES / key / view.file

    def _points_of(self, variants: Sequence[Variant]) -> list[Point]:
        """The points that trained fields are: each rendered as usual."""
        setting = PathSetting() if self._renderings.scatters(self._run) else Setting()
        return [Point(v.key, v.axis, v.label, setting, v.key) for v in variants]

    def _load_trained(self, variant: Variant) -> bool:
        """Loads a variant that an earlier call trained to its end with these options, if there is one. The
        length of the training must only agree if this call trains too."""
        place, options = self._place(variant), variant.options
        try:
            if not is_trained(place):
                return False
            run = Run.load(place)
            if not self.settings.trains:
                known = read_options(run.config, str(run.path))[1]
                options = dataclasses.replace(options, steps=known.steps, seconds=known.seconds)
            expect_options(run, self.capture, variant.preset, options)
        except InputError:
            return False
        self._renderings.fields[variant.key] = run
        return True

    def _all_variants(self) -> list[Variant]:
        steps, seconds = self.settings.steps, self.settings.seconds
        options = dataclasses.replace(training_of(self._run), steps=steps or UNLIMITED,
                                      seconds=seconds if steps is None else 0.0)
        return points.variants_of(self._run.model.field.preset, options)

    def _place(self, variant: Variant) -> Path:
        return self.folder / FIELDS / variant.key

    def _about(self, command: str, views: Sequence[View]) -> dict[str, Any]:
        camera = self.capture.cameras[views[0].camera]
        return {
            "run": {
                "path": str(self._run.path), "preset": self._run.model.field.preset.name,
                "digest": self._renderings.digest(RUN),
            },
            "capture": {"name": self.capture.name, "digest": self.capture.digest},
            "views": [structs.asdict(view) for view in views],
            "size": [camera.w, camera.h],
            "settings": asdict(self.settings) | {"axes": list(self.settings.axes)},
            "scatters": self._renderings.scatters(self._run),
            "lit": self.capture.lighting is not None,
            "command": command,
            "machine": machine.describe(),
        }
