"""What a run costs and gives up on this machine, measured once and kept until run, machine or versions change.

A profile is a file in `$XDG_CACHE_HOME/ndf-mi/profiles`, or `~/.cache/ndf-mi/profiles`, one for each run, size of picture and machine.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import ndf_mi
from ndf_mi import files, machine
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.viewpoint import framing
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.json_input import is_finite
from ndf_mi.render.cost import CostModel, Sample
from ndf_mi.render.image import Image
from ndf_mi.render.settings import Setting, converged, field_digest
from ndf_mi.run import Run

FORMAT = "ndf-profile"
VERSION = 3
#: Longer side in pixels of the pictures measured at most: times of larger ones follow from their rays.
LARGEST = 512
CUTOFFS = (1e-4, 1e-2)
#: Samples a ray, by cutoff: those measured on half of the width and height, with errors, and those on all of it. Powers of two alone would
#: all fill arrays of steady sizes to the same share, and what padding takes could not be told from what samples take.
HALF = {CUTOFFS[0]: (8, 16, 28, 64, 112, 256), CUTOFFS[1]: (8, 40, 128)}
WHOLE = {CUTOFFS[0]: (16, 64, 224), CUTOFFS[1]: (32,)}
AZIMUTHS = (0.0, 120.0)
REPEATS = 3
#: What the machine's pace is told by, one of those of `HALF`; and how far off it may be found.
PACE = Setting(64, CUTOFFS[0])
FARTHEST = 4.0


@dataclass(frozen=True)
class Key:
    """What a profile holds for. It is looked up by run, size and machine, and is stale where anything else differs.

    Attributes:
        run: the folder.
        digest: of the field's architecture and weights.
        code: of the sources that a picture is made by.
        size, geometry: width and height, and whether (u, v, l) and normals are drawn.
        machine: what it is, and the versions on it.
    """

    run: str
    digest: str
    code: str
    size: tuple[int, int]
    geometry: bool
    machine: dict[str, str]

    @classmethod
    def of(cls, run: Run, size: tuple[int, int], geometry: bool) -> Key:
        """The key of now. `geometry` is whether (u, v, l) and normals are drawn, too, which takes longer."""
        return cls(str(run.path.resolve()), field_digest(run), code_digest(), size, geometry, machine.describe())

    @property
    def file(self) -> Path:
        """Where the profile is kept."""
        fixed = [self.run, self.size, self.geometry, *(self.machine[name] for name in ("Processor", "Cores", "Variant"))]
        return cache_folder() / "profiles" / f"{hashlib.sha256(repr(fixed).encode()).hexdigest()[:24]}.json"

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self) | {"size": list(self.size)}


@dataclass(frozen=True)
class Profile:
    """What was measured.

    Attributes:
        samples: settings.
        opacity: of the converged pictures, the mean over the pixels of the body's box: the share of them that the performer fills.
    """

    samples: list[Sample]
    opacity: float

    def model(self) -> CostModel:
        """Time and error as functions of the setting."""
        return CostModel(self.samples)


@functools.cache
def code_digest() -> str:
    """SHA-256 (hex) over the sources that pictures are made by: versions alone do not tell what is being worked on."""
    modules = ("model.py", "run.py", "numerics.py", "coordinates.py", "colour.py", "variants.py")
    return sources_digest("render", "field", "projection", *modules)


def sources_digest(*names: str) -> str:
    """SHA-256 (hex) over sources of the package: modules and folders by name, each with what is below it."""
    state = hashlib.sha256()
    for name in names:
        part = _place(name)
        for file in [part] if part.is_file() else sorted(part.rglob("*.py")):
            state.update(f"{name} {file.relative_to(part)}".encode() + file.read_bytes())
    return state.hexdigest()


def _place(name: str) -> Path:
    spec = find_spec(f"ndf_mi.{name}") if "/" not in name and "." not in name else None
    # An editable installation has the plugins elsewhere.
    return Path(spec.submodule_search_locations[0]) if spec and spec.submodule_search_locations else Path(ndf_mi.__file__).parent / name


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/ndf-mi`, by default `~/.cache/ndf-mi`."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    # As the XDG specification has it: a relative path is ignored.
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "ndf-mi"


def profile_of(run: Run, size: tuple[int, int], geometry: bool, tell: Callable[[str], None]) -> Profile:
    """The profile that is kept, or a new one, which is then kept.

    Args:
        run: the run.
        size: width and height of the pictures.
        geometry: whether (u, v, l) and normals are drawn, too.
        tell: told what is being done.
    """
    key = Key.of(run, size, geometry)
    known, why = read(key)
    if known is not None:
        tell(f"profile: {key.file}")
        return known
    tell(f"profile: {why}; measuring this machine, which is done once")
    begun = time.perf_counter()
    made = measure(run, size, geometry, tell)
    try:
        files.write_json(key.file, {"format": FORMAT, "version": VERSION, "key": key.to_dict(), "opacity": made.opacity,
                                    "samples": [asdict(sample) for sample in made.samples]})
        tell(f"profile: measured in {time.perf_counter() - begun:.0f} s, kept as {key.file}")
    except InputError as error:
        tell(f"profile: measured in {time.perf_counter() - begun:.0f} s, but not kept: {error.found}")
    return made


def read(key: Key) -> tuple[Profile | None, str]:
    """The profile that is kept for a key; or None, and why: there is none, it can't be read, or it is stale."""
    try:
        document = json.loads(key.file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None, "none yet for this run at this size"
    except (OSError, ValueError, RecursionError):
        return None, "the one kept can't be read"
    if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (FORMAT, VERSION):
        return None, "the one kept is of another version"
    kept, now = document.get("key"), key.to_dict()
    if kept != now:
        names, before = {"digest": "weights", "code": "the code that draws"}, kept if isinstance(kept, dict) else now
        changed = next((name for part, name in names.items() if before.get(part) != now[part]), "machine or versions")
        return None, f"the one kept is stale ({changed} changed)"
    try:
        samples = [Sample(**entry) for entry in document["samples"]]
        opacity = document["opacity"]
        numbers = [opacity, *(value for sample in samples for value in asdict(sample).values() if value is not None)]
        if not all(map(is_finite, numbers)) or {s.cutoff for s in samples if s.error is not None} != set(CUTOFFS):
            return None, "the one kept can't be read"
    except (KeyError, TypeError, ValueError):
        return None, "the one kept can't be read"
    return Profile(samples, opacity), ""


def measure(run: Run, size: tuple[int, int], geometry: bool, tell: Callable[[str], None]) -> Profile:
    """Measures settings in two views of the run's, interleaved; kernels are compiled in a round before, which finds the errors, too."""
    whole, half = _sizes(size)
    views = _views(run)
    jobs = [(pixels, Setting(n, cutoff)) for pixels, plan in ((half, HALF), (whole, WHOLE)) for cutoff, ns in plan.items() for n in ns]
    first: dict[tuple[int, int], tuple[Image, float | None]] = {}
    seconds: dict[tuple[int, int], list[float]] = {}
    opacities = []
    for number, (frame, azimuth) in enumerate(views):
        tell(f"profile: compiling and finding errors, view {number + 1} of {len(views)}")
        small = _camera(run, frame, azimuth, half)
        true = converged().image(run, frame, small)
        truth, mask = true.over(run.background), metrics.box_mask(small, run.poses.vertices[run.poses.index(frame)])
        opacities.append(float(true.opacity[mask].mean()) if mask.any() else 0.0)
        for index, (pixels, setting) in enumerate(jobs):
            image = setting.image(run, frame, _camera(run, frame, azimuth, pixels), geometry)
            error = float(np.mean(np.square(image.over(run.background) - truth)[mask])) if pixels == half and mask.any() else None
            first[number, index] = image, error
    for repeat in range(REPEATS):
        tell(f"profile: timing, {repeat + 1} of {REPEATS}")
        for number, (frame, azimuth) in enumerate(views):
            for index in np.random.default_rng([repeat, number]).permutation(len(jobs)):
                pixels, setting = jobs[index]
                camera = _camera(run, frame, azimuth, pixels)
                begun = time.perf_counter()
                setting.image(run, frame, camera, geometry)
                seconds.setdefault((number, int(index)), []).append(time.perf_counter() - begun)
    samples = []
    for index, (_, setting) in enumerate(jobs):
        works = [first[number, index][0].work for number in range(len(views))]
        errors = [error for number in range(len(views)) if (error := first[number, index][1]) is not None]
        taken = statistics.mean(statistics.median(seconds[number, index]) for number in range(len(views)))
        names = ("tiles", "lanes", "evaluated", "launched")
        counts = {name: statistics.mean(getattr(work, name) for work in works) for name in names}
        error = statistics.mean(errors) if errors else None
        samples.append(Sample(setting.samples, setting.cutoff, **counts, seconds=taken, error=error))
    return Profile(samples, statistics.mean(opacities))


def pace(run: Run, size: tuple[int, int], geometry: bool, profile: Profile) -> float:
    """How many times as long pictures take now as when the profile was measured: processors, above all shared ones, do not always go at
    one pace. From some of the profile's own pictures, drawn again, in a second or two."""
    known = next((s for s in profile.samples if (s.samples, s.cutoff) == (PACE.samples, PACE.cutoff) and s.error is not None), None)
    if known is None:
        return 1.0
    taken = []
    for frame, azimuth in _views(run):
        camera = _camera(run, frame, azimuth, _sizes(size)[1])
        each = []
        for _ in range(1 + REPEATS):
            begun = time.perf_counter()
            PACE.image(run, frame, camera, geometry)
            each.append(time.perf_counter() - begun)
        # The first one may have compiled.
        taken.append(statistics.median(each[1:]))
    return float(np.clip(statistics.mean(taken) / known.seconds, 1 / FARTHEST, FARTHEST))


def _sizes(size: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The larger and the smaller pictures that are measured for a size."""
    shrink = min(LARGEST / max(size), 1.0)
    whole = (max(round(shrink * size[0]), 2), max(round(shrink * size[1]), 2))
    return whole, (max(whole[0] // 2, 1), max(whole[1] // 2, 1))


def _views(run: Run) -> list[tuple[int, float]]:
    """Frames and azimuths that are looked from."""
    frames = [int(run.poses.frames[i * (len(run.poses.frames) - 1) // max(len(AZIMUTHS) - 1, 1)]) for i in range(len(AZIMUTHS))]
    return list(zip(frames, AZIMUTHS, strict=True))


def _camera(run: Run, frame: int, azimuth: float, pixels: tuple[int, int]) -> Camera:
    return framing(run.poses.vertices[run.poses.index(frame)], *pixels, azimuth)
