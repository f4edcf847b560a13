"""The points of the study: what is varied, one axis after the other, and a few combinations."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ndf_mi import variants
from ndf_mi.field import PRESETS, Preset
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import QUADRATURE, relightable
from ndf_mi.model import networks_here
from ndf_mi.render.settings import Setting

RENDERING = ("samples", "stratified", "termination", "evaluation", "precision", "rays", "size", "together")
PATHS = ("path",)
TRAINED = ("band", "width", "encoding", "preset")
AXES = (*RENDERING, *PATHS, *TRAINED)
OWN = "own"
"""The variant that other trained fields are compared with: the run's own preset, trained as they are."""
RUN = "run"
"""The name of the run among the fields."""
_LAYERS = ("density_layers", "colour_layers", "colour_linear", "deformation_layers")


@dataclass(frozen=True)
class PathSetting:
    """How `volpath` renders a run.

    Attributes:
        spp: paths a pixel, an even number.
        bounds: `box` (the body's padded box), `shell` (the tight shell), or `nested` (shells with local
            majorants).
        grid_spacing: spacing in metres of the grid that the field is evaluated on; 0 for the field itself.
    """

    spp: int = 8
    bounds: str = "nested"
    grid_spacing: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON values; the grid's spacing only if there is a grid."""
        values = dataclasses.asdict(self)
        return values if self.grid_spacing > 0 else {"spp": self.spp, "bounds": self.bounds}


@dataclass(frozen=True)
class Point:
    """One point of the trade.

    Attributes:
        key: its unique name, also that of its folder.
        axis: what is varied, one of `AXES`, or `usual` for the point that all others are compared with.
        label: its name for readers.
        setting: how it is rendered.
        field: `run`, or the key of a variant that the study trains.
    """

    key: str
    axis: str
    label: str
    setting: Setting | PathSetting = dataclasses.field(default_factory=Setting)
    field: str = RUN

    @property
    def by_paths(self) -> bool:
        """Whether it is path traced: such pictures show the field lit by the scene."""
        return isinstance(self.setting, PathSetting)


@dataclass(frozen=True)
class Variant:
    """A field that the study trains: the run's own preset and options, changed."""

    key: str
    axis: str
    label: str
    preset: Preset
    options: TrainingOptions


def rendering_points(preset: Preset) -> list[Point]:
    """The points of the axes `RENDERING` and `PATHS`, which need no training; the usual setting is first."""
    usual = Setting()
    points = [Point("usual", "usual", f"as usual: {usual.samples} samples", usual)]

    def add(axis: str, key: str, label: str, **change: Any) -> None:
        points.append(Point(key, axis, label, dataclasses.replace(usual, **change)))

    for n in (8, 16, 32, 64, 256, 512):
        add("samples", f"samples-{n}", f"{n} samples", samples=n)
    for n in (16, 32, 128):
        add("stratified", f"stratified-{n}", f"{n} samples, shifted at random", samples=n, stratified=True)
    for c in (0.0, 1e-3, 1e-2, 1e-1):
        label = f"rays end at transmittance {c:g}" if c else "every ray to its end"
        add("termination", f"cutoff-{c:g}", label, cutoff=c)
    # `auto` takes one of the two forms; the other one is the point.
    width = max(width for name in _LAYERS for width in getattr(preset, name))
    other = "batched" if width <= variants.fused_width() else "fused"
    forms = {
        "batched": ("evaluation", "networks as matrix products"),
        "fused": ("evaluation", "networks as cooperative vectors"),
        "half": ("precision", "cooperative vectors in half precision"),
    }
    for form in (other, "half"):
        if form in networks_here():
            add(forms[form][0], form, forms[form][1], networks=form)
    for n in (2, 4, 8):
        add("rays", f"rays-{n}", f"{n} rays a pixel", spp=n)
    for share in (0.25, 0.5, 0.75):
        add("size", f"size-{share:g}", f"{share:g} of the width and height", size=share)
    for share in (0.5, 1.0):
        for n in (16, 32, 64):
            label = f"{n} samples, to 0.01" + (f", {share:g} of the size" if share < 1 else "")
            key = f"samples-{n}-cutoff-0.01-size-{share:g}"
            add("together", key, label, samples=n, cutoff=1e-2, size=share)
    add("together", "samples-32-rays-4", "32 samples, 4 rays a pixel", samples=32, spp=4)
    usual_paths = PathSetting().spp
    points += [Point(f"path-{n}", "path", f"{n} paths a pixel", PathSetting(n)) for n in (2, usual_paths, 32)]
    for bounds, name in (("box", "bounding box"), ("shell", "shell")):
        label = f"{usual_paths} paths a pixel, in the {name}"
        points.append(Point(f"path-{bounds}", "path", label, PathSetting(bounds=bounds)))
    if preset.direction_octaves < 0:
        # A grid holds one colour for all directions.
        for mm, n in ((12, usual_paths), (6, usual_paths), (3, usual_paths), (3, 32), (3, 128)):
            label = f"{n} paths a pixel, on a grid of {mm} mm"
            points.append(Point(f"path-grid-{mm}-{n}", "path", label, PathSetting(n, grid_spacing=mm / 1000)))
    return points


def variants_of(preset: Preset, options: TrainingOptions) -> list[Variant]:
    """The fields that the axes `TRAINED` need; the first has the run's own preset.

    Args:
        preset: the run's.
        options: of every training; the preset `paper` is trained with the published options for as many steps
            or seconds.
    """

    def variant(axis: str, key: str, label: str, **change: Any) -> Variant:
        return Variant(key, axis, label, dataclasses.replace(preset, **change), options)

    found = [variant(OWN, OWN, f"{preset.name}, unchanged")]
    for factor in (0.5, 2.0):
        band = preset.band * factor
        change = {"band": band, "band_inside": min(preset.band_inside, band)}
        found.append(variant("band", f"band-{factor:g}", f"band of {100 * band:g} cm", **change))
    for factor in (0.5, 2.0):
        layers: dict[str, Any] = {
            key: tuple(max(round(factor * w), 4) for w in getattr(preset, key)) for key in _LAYERS
        }
        widths = "–".join(map(str, dict.fromkeys((*layers["density_layers"], *layers["colour_layers"]))))
        found.append(variant("width", f"width-{factor:g}", f"layers of {widths}", **layers))
    if preset.encoding == "grid":
        label = "frequencies in place of the grid"
        found.append(variant("encoding", "frequency", label, encoding="frequency"))
        for n in (max(preset.grid_finest // 4, preset.grid_base + 1), 2 * preset.grid_finest):
            found.append(variant("encoding", f"grid-{n}", f"grid of up to {n} cells", grid_finest=n))
    else:
        found.append(variant("encoding", "grid", "a hash grid in place of frequencies", encoding="grid"))
    length: dict[str, Any] = {"steps": options.steps, "seconds": options.seconds, "seed": options.seed}
    lit = options.integrator != QUADRATURE
    for name, other in PRESETS.items():
        if name != preset.name:
            trained = TrainingOptions.paper() if name == "paper" and not lit else options
            architecture = relightable(other)[0] if lit else other
            trained = dataclasses.replace(trained, **length)
            found.append(Variant(name, "preset", f"preset {name}", architecture, trained))
    return found
