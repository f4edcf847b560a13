"""What methods that train a volume share: everything but the volume itself."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import drjit as dr
import mitsuba as mi
import msgspec
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.prepare import reference
from ndf_mi.methods.base import Budget, Progress
from ndf_mi.methods.volume.chunks import Chunked
from ndf_mi.methods.volume.medium import boxed
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.rays import RayObjective, RaySettings
from ndf_mi.methods.volume.record import (
    FILE_NAME,
    TENSORS,
    Tensors,
    VolumeRecord,
    expect_shape,
    read_record,
    read_volume,
    write_volume,
)
from ndf_mi.methods.volume.stages import FinalStage, Training
from ndf_mi.methods.volume.volume import Volume
from ndf_mi.render.image import RECIPE, ImageRenderer
from ndf_mi.surface.reference import with_offsets
from ndf_mi.surface.rest_frames import RestFrames

STATE = "state.safetensors"


@dataclass(frozen=True)
class VolumePreset:
    """How a volume is built and trained.

    Attributes:
        architecture: a dataclass of JSON values.
        schedule: rates and length.
        rays: rays and loss.
        surface: what the volume is built on: `body`, or `offset`, the body with static offsets that are
            fitted to the training images first.
    """

    architecture: Any
    schedule: Schedule
    rays: RaySettings
    surface: Literal["body", "offset"] = "body"

    def to_dict(self) -> dict[str, Any]:
        """All options as JSON values."""
        return json.loads(json.dumps(dataclasses.asdict(self)))


class RecordedMethod(ABC):
    """A method whose training is kept as a `VolumeRecord` with tensors, and continues where it was stopped.
    Its folder holds `volume.json` and `volume.safetensors`.
    """

    _record: VolumeRecord
    _tensors: Tensors

    @abstractmethod
    def _train(self, folder: Path | None, capture: Capture, budget: Budget,
               progress: Progress | None) -> None:
        """Trains, or goes on from the state in the folder, where it leaves checkpoints if there is one."""

    @abstractmethod
    def _record_of(self, capture: Capture, budget: Budget) -> VolumeRecord:
        """The record of a training that has not begun."""

    @abstractmethod
    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote."""

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Trains for the budget's seconds, or its own number of steps without them."""
        self._train(None, capture, budget, progress)

    def fit_in(self, folder: str | os.PathLike[str], capture: Capture, budget: Budget,
               progress: Progress | None = None) -> None:
        """As `fit` and `save`. A finished training in the folder is loaded, a stopped one continues, and that
        of another capture, budget or settings is replaced.

        Raises:
            KeyboardInterrupt: stopped by a signal; the next call continues.
        """
        folder = Path(folder)
        try:
            if read_record(folder).same_training(self._record_of(capture, budget)):
                return self.load(folder, capture)
        except InputError:
            pass  # there is none, or it is damaged
        (folder / FILE_NAME).unlink(missing_ok=True)
        self._train(folder, capture, budget, progress)
        self.save(folder)
        (folder / STATE).unlink(missing_ok=True)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes `volume.safetensors`, and `volume.json` last."""
        write_volume(folder, self._record, self._tensors)


class VolumeMethod(RecordedMethod):
    """A method whose volume is trained on rays of the training images and rendered by quadrature, one ray
    through each pixel's centre.

    A method derives from this, and defines `key`, `label`, `presets` and `volume`.

    Args:
        preset: one of `presets`.
        samples: candidate samples a ray of images.

    Attributes:
        parameters: what was trained, once it was, or loaded; detached.

    Raises:
        InputError: there is no such preset, or `samples` is not above 0.
    """

    key: str
    label: str
    presets: ClassVar[Mapping[str, VolumePreset]]

    def __init__(self, preset: str = "fast", samples: int = 128) -> None:
        if preset not in self.presets:
            raise InputError(f"method {self.key}: preset", repr(preset),
                             "one of " + ", ".join(self.presets))
        self.preset = self.presets[preset]
        self._name = preset
        self._renderer = ImageRenderer(samples=samples)

    def volume(self, capture: Capture, architecture: Any) -> Volume:
        """The volume for a capture, whose body and poses are those of the surface to build on.

        Raises:
            InputError: the capture lacks what it needs.
        """
        raise NotImplementedError

    def final_stage(self, volume: Any) -> FinalStage | None:
        """What is trained last, within the budget; None for nothing. The volume is one of :meth:`volume`."""
        return None

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote.

        Raises:
            InputError: a file is missing or damaged, or does not belong to the method, the capture or a
                preset of this version.
        """
        record, tensors = read_volume(folder, self.key, capture)
        for name, preset in self.presets.items():
            if preset.to_dict() == record.preset:
                self._name, self.preset = name, preset
                break
        else:
            raise InputError(f"{Path(folder) / FILE_NAME}: preset", "options of another version",
                             "those of " + " or ".join(self.presets), "Train it again.")
        volume = self._place(capture, tensors.get("offsets"))
        final, rng = self.final_stage(volume), np.random.default_rng(0)
        for name, value in {**volume.initial(rng), **({} if final is None else final.initial(rng))}.items():
            expect_shape(f"{Path(folder) / TENSORS}: {name}", tensors.get(name), value.shape)
        self._take(capture, volume, record, tensors)

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background."""
        with dr.suspend_grad():
            posed = self._volume.at(frame, self.parameters)
            return self._renderer(Chunked(posed), camera).over(self._background)

    def shape(self, frame: int) -> dict[str, Any]:
        """The performer at `frame` as a shape of a scene for `mi.load_dict`, where the integrators `ndf_path`
        and `ndf_quadrature` show it. Its parameters are not exposed."""
        return boxed(Chunked(self._volume.at(frame, self.parameters)), f"{self.key}-{self.cache_key()[:12]}",
                     frame)

    def training_settings(self) -> dict[str, Any]:
        """As `methods.base.Configured`: the preset's options."""
        return self.preset.to_dict()

    def metadata(self) -> dict[str, Any]:
        """The members of the record, and keys that `methods.base` lists."""
        known = msgspec.to_builtins(self._record)
        more = known.pop("more")
        known["architecture"] = known.pop("preset")
        return {**known, **more, "preset": self._name, "parameters": self.size,
                "options": {"preset": self._name, "samples": self._renderer.samples}}

    def cache_key(self) -> str:
        """SHA-256 (hex) over parameters, surface, preset, capture and how images are rendered."""
        record = self._record
        how = [RECIPE, self._renderer.samples, record.method, record.preset, record.capture]
        state = hashlib.sha256(json.dumps(how).encode())
        for name, values in sorted(self._tensors.items()):
            state.update(name.encode() + values.tobytes())
        return state.hexdigest()

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(value.size for name, value in self._tensors.items() if name != "offsets")

    def _train(self, folder: Path | None, capture: Capture, budget: Budget,
               progress: Progress | None) -> None:
        record, preset = self._record_of(capture, budget), self.preset
        file = None if folder is None else folder / STATE
        training = None if file is None else Training.resumed(file, record)
        if training is None:
            options = TrainingOptions(surface=preset.surface, seconds=budget.seconds or 0.0, seed=budget.seed)
            surface = reference(capture, options)
            offsets = {name: surface.tensors[name] for name in ("offsets",) if name in surface.tensors}
            record.surface_seconds = record.seconds = surface.seconds
            training = Training(record, offsets, file)
        volume = self._place(capture, training.tensors.get("offsets"))
        final, record, seconds = self.final_stage(volume), training.record, budget.seconds
        on_rays = training.run(
            0, volume.initial(np.random.default_rng([budget.seed, 0])),
            RayObjective(capture, volume, preset.rays), preset.schedule,
            seconds if seconds is None or final is None else (1 - final.share) * seconds,
            volume.rates, progress)
        if on_rays is not None:
            record.steps, record.history = on_rays.steps, on_rays.history
        if final is not None:
            parameters = {name: mi.Float(value) for name, value in training.tensors.items()
                          if name != "offsets"}

            def report(spent: float, step: int, _: float) -> None:
                # The last stage sees no image, so that the error on images stays what it was.
                if progress is not None and record.history:
                    progress(spent, record.steps + step, record.history[-1][2])

            last = training.run(1, final.initial(np.random.default_rng([budget.seed, 2])),
                                final.objective(parameters), final.schedule, seconds, progress=report)
            assert last is not None
            record.more = {"note": final.note, "final_steps": last.steps, "final_loss": last.error}
        self._take(capture, volume, record, training.tensors)

    def _record_of(self, capture: Capture, budget: Budget) -> VolumeRecord:
        """The record of a training that has not begun."""
        return VolumeRecord(method=self.key, preset=self.preset.to_dict(), capture=capture.digest,
                            seed=budget.seed, budget=budget.seconds)

    def _place(self, capture: Capture, offsets: np.ndarray | None) -> Volume:
        """The volume on the capture's body, with these offsets if there are any."""
        if offsets is not None:
            capture = capture.with_body(*with_offsets(capture, RestFrames(capture), offsets))
        return self.volume(capture, self.preset.architecture)

    def _take(self, capture: Capture, volume: Volume, record: VolumeRecord, tensors: Tensors) -> None:
        self._background, self._volume = capture.background, volume
        self._record, self._tensors = record, tensors
        self.parameters = {name: mi.Float(value) for name, value in tensors.items() if name != "offsets"}

