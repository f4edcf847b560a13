"""A trained field on disk: all that is needed to render it, without its capture.

    RUN/config.json         preset, options, capture and versions that it was made with
    RUN/field.safetensors   `weights`, and `grid` where the preset has a hash table
    RUN/body.npz poses.npz  the reference surface: a body and its poses, in the format of a capture
    RUN/surface.safetensors how the reference surface differs from the capture's body; only where it does
"""

from __future__ import annotations

import contextlib
import json
import os
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias
from weakref import WeakValueDictionary

import mitsuba as mi
import msgspec
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from ndf_mi import files
from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.errors import InputError
from ndf_mi.field import Field, FieldParameters, Preset
from ndf_mi.json_input import load_json, validated
from ndf_mi.model import Model, PosedModel
from ndf_mi.projection import PosedSurface

FORMAT = "ndf-run"
VERSIONS = (1, 2)
"""Version 2 has bands that differ from place to place, which programs of version 1 would not notice."""
SURFACE = "surface.safetensors"
QUADRATURE = "ndf_quadrature"
"""The integrator that fields are trained with by default."""
_FILES = ("config.json", "body.npz", "poses.npz", "field.safetensors")
_CACHED_POSES = 128
_Fraction: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=1)]
_SHARED: WeakValueDictionary[tuple[object, ...], Run] = WeakValueDictionary()
"""Runs in use, by folder, variant and the files' signatures."""


class _Config(msgspec.Struct):
    """What every configuration holds; see `Run.config`."""

    preset: dict[str, Any]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    background: tuple[_Fraction, _Fraction, _Fraction]


class Run:
    """A field with its reference surface.

    Attributes:
        path: the folder.
        config: the contents of ``config.json``: `preset` (all options), `background` (3 numbers, sRGB),
            `capture` (`name`, `digest`), `training` and more, as training wrote them.
        body, poses: the reference surface: the capture's body, or that with offsets and a refined fit.
        surface_tensors: what `surface.safetensors` holds, by name: `offsets` (V, 3), added to the capture's
            body at rest, `bands` (V, 2), and corrections of the fit. Empty where the surface is that body.
        model: architecture and coordinates of the field.
        parameters: the field's; training replaces them.
    """

    def __init__(
        self, path: str | os.PathLike[str], config: dict[str, Any], body: Body, poses: Poses, model: Model,
        parameters: FieldParameters, surface_tensors: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        self.path = Path(path)
        self.config = config
        self.body = body
        self.poses = poses
        self.model = model
        self.parameters = parameters
        self.surface_tensors = dict(surface_tensors or {})
        self._surfaces: OrderedDict[int, PosedSurface] = OrderedDict()

    @property
    def background(self) -> np.ndarray:
        """(3,) float32 sRGB, behind the performer."""
        return np.asarray(self.config["background"], dtype=np.float32)

    @property
    def bands(self) -> np.ndarray | None:
        """(V, 2) float32 metres, how far the band reaches outside and inside at each vertex; None where it is
        the preset's everywhere."""
        return self.surface_tensors.get("bands")

    @property
    def scattered(self) -> bool:
        """Whether it was trained through scattering, beyond the steps by quadrature that come first. Read
        from the configuration, which is complete once training has ended or was interrupted."""
        training = self.config.get("training")
        if not isinstance(training, dict) or training.get("integrator", QUADRATURE) == QUADRATURE:
            return False
        trained = self.config.get("trained")
        steps = trained.get("steps") if isinstance(trained, dict) else None
        return not isinstance(steps, int) or steps > training.get("warm_up", 0)

    @property
    def colours(self) -> Literal["light", "albedo"] | None:
        """What the field's colours are: the light in its capture, or albedos; None where the run does not
        record its training."""
        if not isinstance(self.config.get("training"), dict):
            return None
        return "albedo" if self.scattered else "light"

    @classmethod
    def create(
        cls, path: str | os.PathLike[str], preset: Preset, body: Body, poses: Poses, seed: int,
        surface_tensors: Mapping[str, np.ndarray] | None = None, **config: Any
    ) -> Run:
        """A new run with untrained parameters. Nothing is written until :meth:`save`."""
        tensors = dict(surface_tensors or {})
        version = VERSIONS[-1] if "bands" in tensors else VERSIONS[0]
        config = {"format": FORMAT, "version": version, "preset": preset.to_dict(), "seed": seed, **config}
        model = _model(body, poses, preset, tensors)
        return cls(path, config, body, poses, model, model.field.initial_parameters(seed), tensors)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Run:
        """Reads a run.

        Raises:
            InputError: a file is missing or does not fit; the message names it and the key.
        """
        path = Path(path)
        config = _read_config(path / "config.json")
        preset = Preset.from_dict(config["preset"], f"{path / 'config.json'}: preset")
        body = Body.read(path / "body.npz")
        poses = Poses.read(path / "poses.npz", body)
        tensors = _read_surface(path / SURFACE, poses.vertices.shape[1])
        if config["version"] > VERSIONS[0] and "bands" not in tensors:
            raise InputError(path / SURFACE, "no bands" if tensors else "no such file",
                             "the bands of a run of version 2")
        model = _model(body, poses, preset, tensors)
        parameters = _read_parameters(path / "field.safetensors", model.field)
        return cls(path, config, body, poses, model, parameters, tensors)

    @classmethod
    def shared(cls, path: str | os.PathLike[str]) -> Run:
        """As :meth:`load`, but returns the same object for the same folder, as long as it is in use and its
        files stay the same. Do not change it."""
        folder = os.path.realpath(path)
        try:
            states = [os.stat(os.path.join(folder, name)) for name in _FILES]
        except OSError:
            return cls.load(path)
        with contextlib.suppress(FileNotFoundError):
            states.append(os.stat(os.path.join(folder, SURFACE)))
        key = (folder, mi.variant(), *((state.st_ino, state.st_mtime_ns, state.st_size) for state in states))
        run = _SHARED.get(key)
        if run is None:
            run = _SHARED[key] = cls.load(path)
        return run

    def field_tensors(self) -> dict[str, np.ndarray]:
        """The field's parameters as numpy arrays by name."""
        return self.parameters.arrays()

    def tensors(self) -> dict[str, np.ndarray]:
        """The field's parameters and how the surface differs from the capture's body, by name, for cache keys
        of images."""
        return self.field_tensors() | self.surface_tensors

    def save(self) -> None:
        """Writes the run, each file completely or not at all, ``config.json`` last."""
        json.dumps(self.config, allow_nan=False)  # Fails before anything is written.
        self.body.write(self.path / "body.npz")
        self.poses.write(self.path / "poses.npz")
        self.save_surface()
        self.save_field()
        files.write_json(self.path / "config.json", self.config)

    def save_field(self) -> None:
        """Writes only the field's parameters."""
        with files.replacing(self.path / "field.safetensors") as beside:
            save_file(self.field_tensors(), beside)

    def replace_poses(self, poses: Poses) -> None:
        """Takes other poses of the same frames and body, as a refined fit has."""
        self.poses = poses
        self._surfaces.clear()

    def save_fit(self) -> None:
        """Writes only the poses and `surface.safetensors`, which a refined fit changes."""
        self.poses.write(self.path / "poses.npz")
        self.save_surface()

    def save_surface(self) -> None:
        """Writes only `surface.safetensors`, or deletes it where there is nothing to write: an unfinished run
        of other options may have left one."""
        if not self.surface_tensors:
            (self.path / SURFACE).unlink(missing_ok=True)
            return
        with files.replacing(self.path / SURFACE) as beside:
            save_file(self.surface_tensors, beside)

    def surface(self, frame: int) -> PosedSurface:
        """The reference surface at a frame, ready for queries; the most recently used frames are kept. Raises
        InputError if there is no such frame."""
        row = self.poses.index(frame)
        if row in self._surfaces:
            self._surfaces.move_to_end(row)
        else:
            vertices = _flat(self.poses.vertices[row])
            self._surfaces[row] = self.model.pose(vertices)
            if len(self._surfaces) > _CACHED_POSES:
                self._surfaces.popitem(last=False)
        return self._surfaces[row]

    def pose_vector(self, frame: int) -> mi.Float:
        """Flat (3·J) axis-angles at a frame, the root's three zero."""
        return _flat(self.poses.pose[self.poses.index(frame)])

    def posed(
        self, frame: int, networks: str = "auto", parameters: FieldParameters | None = None
    ) -> PosedModel:
        """The field at one of the poses' frames.

        Args:
            networks: as in :class:`PosedModel`.
            parameters: used instead of the run's own; gradients flow to them.
        """
        surface, pose = self.surface(frame), self.pose_vector(frame)
        return PosedModel(self.model, parameters or self.parameters, surface, pose, networks=networks)

    def posed_as(self, vertices: np.ndarray, pose: np.ndarray, networks: str = "auto") -> PosedModel:
        """The field around a body in any pose.

        Args:
            vertices: (V, 3) of the posed body, world, in metres.
            pose: (J, 3) axis-angles of the joints relative to their parents, in radians, the root's zero.
        """
        surface = self.model.pose(_flat(vertices))
        return PosedModel(self.model, self.parameters, surface, _flat(pose), networks=networks)


def _model(body: Body, poses: Poses, preset: Preset, tensors: Mapping[str, np.ndarray]) -> Model:
    return Model(body, poses, preset, tensors.get("bands"))


def _flat(values: np.ndarray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(values, np.float32).ravel())


def _read_config(path: Path) -> dict[str, Any]:
    config = load_json(path, "a run made by `ndf-mi optimise`")
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        found = config.get("format") if isinstance(config, dict) else type(config).__name__
        raise InputError(f"{path}: format", repr(found), repr(FORMAT))
    if config.get("version") not in VERSIONS:
        newer = isinstance(config.get("version"), int) and config["version"] > VERSIONS[-1]
        raise InputError(f"{path}: version", repr(config.get("version")), " or ".join(map(str, VERSIONS)),
                         "A newer ndf-mi wrote it: upgrade with `pip install -U ndf-mi`." if newer else "")
    validated(config, _Config, str(path))
    return config


def _read_tensors(path: Path, expected: str) -> dict[str, np.ndarray]:
    try:
        return dict(load_file(path))
    except FileNotFoundError:
        raise InputError(path, "no such file", expected) from None
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a safetensors file") from None


def _read_surface(path: Path, vertices: int) -> dict[str, np.ndarray]:
    """The tensors of `surface.safetensors`; none where there is no such file."""
    if not path.exists():
        return {}
    tensors = _read_tensors(path, "the reference surface")
    for name, columns in (("offsets", 3), ("bands", 2)):
        found = tensors.get(name)
        if found is not None and (found.shape != (vertices, columns) or found.dtype != np.float32):
            raise InputError(f"{path}: {name}", f"{found.dtype} of shape {found.shape}",
                             f"float32 of shape {(vertices, columns)}, a row a vertex")
    for name, found in tensors.items():
        if not np.isfinite(found).all():
            raise InputError(f"{path}: {name}", "numbers that are not finite", "finite numbers")
    return tensors


def _read_parameters(path: Path, field: Field) -> FieldParameters:
    tensors = _read_tensors(path, "the field's weights")
    for name, size in (("weights", field.size), ("grid", field.grid_size)):
        if name not in tensors:
            if size == 0:
                continue
            raise InputError(f"{path}: {name}", "no such tensor", f"{size} numbers")
        found = tensors[name]
        if found.shape != (size,) or found.dtype != np.float32:
            expected = f"float32 of shape {(size,)}, as the preset has"
            raise InputError(f"{path}: {name}", f"{found.dtype} of shape {found.shape}", expected)
        if not np.isfinite(found).all():
            raise InputError(f"{path}: {name}", "numbers that are not finite", "finite numbers")
    grid = mi.Float(tensors["grid"]) if field.grid_size else None
    return FieldParameters(mi.Float(tensors["weights"]), grid)
