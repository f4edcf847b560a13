"""A trained field on disk: all that a medium needs to render it, without the capture it was trained on.

    RUN/config.json         what it is and how it was made
    RUN/field.safetensors   `weights`, and `grid` where the preset has a hash table
    RUN/body.npz poses.npz  the body and its poses, as in a capture
"""

from __future__ import annotations

import json
import os
from collections import OrderedDict
from pathlib import Path
from typing import Any, Literal
from weakref import WeakValueDictionary

import mitsuba as mi
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from ndf_mi import files
from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.errors import InputError
from ndf_mi.field import Field, FieldParameters, Preset
from ndf_mi.model import Model, PosedModel
from ndf_mi.projection import PosedSurface

FORMAT = "ndf-run"
VERSION = 1
QUADRATURE = "ndf_quadrature"
"""The integrator that fields are trained by where nothing else is said."""
_FILES = ("config.json", "body.npz", "poses.npz", "field.safetensors")
_CACHED_POSES = 128
_SHARED: WeakValueDictionary[tuple[object, ...], Run] = WeakValueDictionary()
"""Runs in use, by folder, variant and the files' signatures."""


class Run:
    """A field with its body and poses.

    Attributes:
        path: the folder.
        config: the contents of ``config.json``: `preset` (all options), `background` (3 numbers, sRGB), `capture` (`name`, `digest`),
            `training` and more, as the trainer wrote them.
        body, poses: as in the capture.
        model: architecture and coordinates of the field.
        parameters: of the field.
    """

    def __init__(self, path: str | os.PathLike[str], config: dict[str, Any], body: Body, poses: Poses, model: Model,
                 parameters: FieldParameters) -> None:
        self.path = Path(path)
        self.config = config
        self.body = body
        self.poses = poses
        self.model = model
        self.parameters = parameters
        self._surfaces: OrderedDict[int, PosedSurface] = OrderedDict()

    @property
    def background(self) -> np.ndarray:
        """(3,) float32 sRGB of what lies behind the performer."""
        return np.asarray(self.config["background"], dtype=np.float32)

    @property
    def scattered(self) -> bool:
        """Whether it has been trained through scattering, and longer than the steps by quadrature that come first: by what the
        configuration says, which is complete once a training has ended or was interrupted."""
        training = self.config.get("training")
        if not isinstance(training, dict) or training.get("integrator", QUADRATURE) == QUADRATURE:
            return False
        trained = self.config.get("trained")
        steps = trained.get("steps") if isinstance(trained, dict) else None
        return not isinstance(steps, int) or steps > training.get("warm_up", 0)

    @property
    def colours(self) -> Literal["light", "albedo"] | None:
        """What the field's colours are: the light that was seen in its capture, or albedos; None where nothing says how it was trained."""
        if not isinstance(self.config.get("training"), dict):
            return None
        return "albedo" if self.scattered else "light"

    @classmethod
    def create(cls, path: str | os.PathLike[str], preset: Preset, body: Body, poses: Poses, seed: int, **config: Any) -> Run:
        """A fresh run with untrained weights; nothing is written until :meth:`save`."""
        config = {"format": FORMAT, "version": VERSION, "preset": preset.to_dict(), "seed": seed, **config}
        model = Model(body, poses, preset)
        return cls(path, config, body, poses, model, model.field.initial_parameters(seed))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Run:
        """Reads a run.

        Raises:
            InputError: naming the file and key at fault, what was found and what was expected.
        """
        path = Path(path)
        config = _read_config(path / "config.json")
        preset = Preset.from_dict(config["preset"], f"{path / 'config.json'}: preset")
        body = Body.read(path / "body.npz")
        poses = Poses.read(path / "poses.npz", body)
        model = Model(body, poses, preset)
        return cls(path, config, body, poses, model, _read_parameters(path / "field.safetensors", model.field))

    @classmethod
    def shared(cls, path: str | os.PathLike[str]) -> Run:
        """As :meth:`load`, but one run for all who ask for the same folder while one of them holds it and its files stay the same.

        It must not be changed.
        """
        folder = os.path.realpath(path)
        try:
            states = [os.stat(os.path.join(folder, name)) for name in _FILES]
        except OSError:
            return cls.load(path)
        key = (folder, mi.variant(), *((state.st_ino, state.st_mtime_ns, state.st_size) for state in states))
        run = _SHARED.get(key)
        if run is None:
            run = _SHARED[key] = cls.load(path)
        return run

    def field_tensors(self) -> dict[str, np.ndarray]:
        """The field's parameters as numpy arrays, by name."""
        return self.parameters.arrays()

    def save(self) -> None:
        """Writes the run; each file whole or not at all, ``config.json`` last."""
        json.dumps(self.config, allow_nan=False)  # before anything is written
        self.body.write(self.path / "body.npz")
        self.poses.write(self.path / "poses.npz")
        self.save_field()
        files.write_json(self.path / "config.json", self.config)

    def save_field(self) -> None:
        """Writes the field's parameters alone."""
        with files.replacing(self.path / "field.safetensors") as beside:
            save_file(self.field_tensors(), beside)

    def surface(self, frame: int) -> PosedSurface:
        """The body at a frame, with its boxes and cells; kept for the frames used last.

        Raises:
            InputError: there is no such frame.
        """
        row = self.poses.index(frame)
        if row in self._surfaces:
            self._surfaces.move_to_end(row)
        else:
            vertices = mi.Float(self.poses.vertices[row].ravel())
            self._surfaces[row] = PosedSurface(self.model.surface, vertices, self.model.band)
            if len(self._surfaces) > _CACHED_POSES:
                self._surfaces.popitem(last=False)
        return self._surfaces[row]

    def pose_vector(self, frame: int) -> mi.Float:
        """Flat (3·J) axis-angles at a frame, the root's three zero."""
        return mi.Float(np.ascontiguousarray(self.poses.pose[self.poses.index(frame)], dtype=np.float32).ravel())

    def posed(self, frame: int, networks: str = "auto", parameters: FieldParameters | None = None) -> PosedModel:
        """The field at a frame.

        Args:
            frame: one of the poses'.
            networks: as in :class:`PosedModel`.
            parameters: in place of the run's own; gradients flow to them.
        """
        return PosedModel(self.model, parameters or self.parameters, self.surface(frame), self.pose_vector(frame), networks=networks)

    def posed_as(self, vertices: np.ndarray, pose: np.ndarray, networks: str = "auto") -> PosedModel:
        """The field around a body in any pose.

        Args:
            vertices: (V, 3) of the posed body, world, in metres.
            pose: (J, 3) axis-angles of the joints relative to their parents, in radians, the root's zero.
            networks: as in :class:`PosedModel`.
        """
        surface = PosedSurface(self.model.surface, mi.Float(np.ascontiguousarray(vertices, np.float32).ravel()), self.model.band)
        pose_vector = mi.Float(np.ascontiguousarray(pose, np.float32).ravel())
        return PosedModel(self.model, self.parameters, surface, pose_vector, networks=networks)


def _read_config(path: Path) -> dict[str, Any]:
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "no such file", "a run made by `ndf-mi optimise`") from None
    except (OSError, ValueError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "JSON") from None
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        found = config.get("format") if isinstance(config, dict) else type(config).__name__
        raise InputError(f"{path}: format", repr(found), repr(FORMAT))
    if config.get("version") != VERSION:
        newer = isinstance(config.get("version"), int) and config["version"] > VERSION
        raise InputError(f"{path}: version", repr(config.get("version")), str(VERSION),
                         "It was made by a newer ndf-mi: upgrade with `pip install -U ndf-mi`." if newer else "")
    for key, kind in (("preset", dict), ("seed", int), ("background", list)):
        if not isinstance(config.get(key), kind):
            raise InputError(f"{path}: {key}", repr(config.get(key)), f"a {kind.__name__}")
    if config["seed"] < 0:
        raise InputError(f"{path}: seed", str(config["seed"]), "a whole number from 0 on")
    if len(config["background"]) != 3 or not all(isinstance(v, (int, float)) and 0 <= v <= 1 for v in config["background"]):
        raise InputError(f"{path}: background", repr(config["background"]), "three numbers in [0, 1]")
    return config


def _read_parameters(path: Path, field: Field) -> FieldParameters:
    try:
        tensors = load_file(path)
    except FileNotFoundError:
        raise InputError(path, "no such file", "the field's weights") from None
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a safetensors file") from None
    for name, size in (("weights", field.size), ("grid", field.grid_size)):
        if name not in tensors:
            if size == 0:
                continue
            raise InputError(f"{path}: {name}", "no such tensor", f"{size} numbers")
        found = tensors[name]
        if found.shape != (size,) or found.dtype != np.float32:
            raise InputError(f"{path}: {name}", f"{found.dtype} of shape {found.shape}", f"float32 of shape {(size,)}, as the preset has")
        if not np.isfinite(found).all():
            raise InputError(f"{path}: {name}", "numbers that are not finite", "finite numbers")
    return FieldParameters(mi.Float(tensors["weights"]), mi.Float(tensors["grid"]) if field.grid_size else None)
