"""Architectures of the networks: `paper` as published, `fast` as of today, `tiny` for tests."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ndf_mi.deprecated import PRESET_FIELDS, PRESET_VALUES, rename_entries
from ndf_mi.errors import InputError
from ndf_mi.options import read_options


@dataclass(frozen=True)
class Preset:
    """A field's architecture. Every entry is an option of ``ndf-mi optimise``.

    Symbols follow the paper: u* is the projected point (u, v, l), or the alternative that `coordinates`
    names, in the unit cube; ũ = u* + `deformation_scale`·D(u*, θ); γ is the frequency encoding.
    """

    name: str = "fast"
    band: float = 0.08
    """Half width δ_N of the band around the body, in metres."""

    band_inside: float = 0.03
    """How far the band reaches into the body, in metres; at most `band`. Visible surfaces lie outside the
    skin, up to errors of the fit."""

    band_fade: float = 0.1
    """Fraction of the band, at both its edges, over which the density fades smoothly to zero, so that the
    field is continuous; 0 for the paper's hard edge."""

    coordinates: Literal["uv", "surface", "world"] = "uv"
    """The networks' coordinates: `uv`, texture coordinates (u, v) of the closest point, and l; `surface`, the
    closest point on the body at rest (x, y, z), which has no seams, and l; or `world`, the point itself
    (x, y, z), without projection."""

    distance: Literal["signed", "unsigned", "none"] = "signed"
    """How l enters the networks (not with `world`): with its sign, without it, or not at all."""

    sample_factor: int = 1
    """Factor on the candidate samples a ray: samples farther apart than the band is thick would miss it."""

    pose_layers: tuple[int, ...] = (64, 16)
    """Widths of the pose network; the last is the number of features. Empty: no dependence on the pose."""

    pose_products: bool = False
    """Whether the pose features f(θ) also mix matrices: where they join a layer, its matrix W becomes W + Σ_k
    f_k(θ)·W_k, once a pose, at no cost a sample. The field then is a sum of fields, each as fine as the grid,
    with weights that depend on the pose. Features that are only joined to the inputs, as in the paper, shift
    one field."""

    deformation_layers: tuple[int, ...] = (32,)
    """Hidden widths of the deformation net D."""

    deformation_octaves: int = 4
    """Octaves of γ on u* where it enters D."""

    deformation_scale: float = 0.02
    """Factor on D's output, in units of the unit cube."""

    encoding: Literal["frequency", "grid"] = "grid"
    """How ũ enters the density network: γ, or a multiresolution hash grid."""

    octaves: int = 10
    """Octaves of γ on ũ (`frequency` only)."""

    grid_levels: int = 8
    """Levels of the hash grid (`grid` only)."""

    grid_features: int = 2
    """Features at a cell's corner, an even number (`grid` only)."""

    grid_entries: int = 2**16
    """Largest number of cell corners a level that the hash table holds, with `grid_features` numbers each
    (`grid` only)."""

    grid_base: int = 16
    grid_finest: int = 512
    """Resolutions of the coarsest and the finest level, in cells over u and v (`grid` only)."""

    grid_l_scale: float = 0.125
    """Resolution along l relative to that along u and v (`grid` only)."""

    density_layers: tuple[int, ...] = (64,)
    """Hidden widths of the density network M_σ."""

    density_skip: int = 0
    """After this many layers γ(ũ) and the pose features are joined again; 0 for never."""

    feature_width: int = 16
    """Width of the features that the density network passes on; 0 passes its last hidden layer unchanged."""

    colour_linear: tuple[int, ...] = ()
    """Linear layers between the density network and the view direction; the pose joins at the second."""

    colour_layers: tuple[int, ...] = (64,)
    """Hidden widths of the colour network M_c after the view direction has joined."""

    direction_octaves: int = 2
    """Octaves of γ on the view direction; −1: colours are the same from all directions."""

    direction: Literal["view", "mirrored"] = "view"
    """The direction that enters: the view direction as in the paper, or its reflection by the body's normal,
    along which highlights stay fixed as the viewer and the body turn (Verbin et al. 2022, *Ref-NeRF*)."""

    normal_octaves: int = -1
    """Octaves of γ on the world-space normal of the body's surface, which enters the colour network with the
    view direction, so that lighting that is fixed in the world need not be learnt from poses; −1 leaves it
    out."""

    density_activation: Literal["relu", "softplus"] = "softplus"
    """Shape of the density's activation below saturation."""

    density_limit: float = 500.0
    """Least upper bound of the density in 1/m: σ = limit·(1 − exp(−a/limit)), where a is the activation; far
    below the limit, σ equals a. It gives a majorant by construction."""

    density_gain: float = 100.0
    """Factor from the network's output to the activation in 1/m."""

    density_bias: float = -4.0
    """Added to the network's output before the activation (`softplus` only); how thin the field starts."""

    def __post_init__(self) -> None:
        for key, good, expected in self._requirements():
            if not good:
                raise InputError(f"preset option {key}", repr(getattr(self, key)), expected)

    def _requirements(self) -> Iterator[tuple[str, bool, str]]:
        """Option, whether its value is good, and what is expected."""
        hints = get_type_hints(type(self))
        for key, value in vars(self).items():
            if get_origin(hints[key]) is Literal:
                yield key, value in get_args(hints[key]), " or ".join(get_args(hints[key]))
            elif isinstance(value, float):
                yield key, abs(value) < float("inf"), "a number"
            elif isinstance(value, tuple):
                good = all(type(width) is int and width > 0 for width in value)
                yield key, good, "a list of widths above 0"
        for key in ("band", "density_limit", "density_gain", "grid_l_scale"):
            yield key, getattr(self, key) > 0, "a number above 0"
        for key, least in (("deformation_octaves", 0), ("octaves", 0), ("feature_width", 0),
                           ("normal_octaves", -1), ("direction_octaves", -1)):
            yield key, least <= getattr(self, key) <= 1024, f"a whole number from {least} to 1024"
        yield ("band_inside", 0 < self.band_inside <= self.band,
               f"a number above 0, at most the band's {self.band}")
        yield "band_fade", 0 <= self.band_fade < 1, "a fraction in [0, 1)"
        yield "sample_factor", self.sample_factor >= 1, "a whole number above 0"
        yield "density_layers", bool(self.density_layers), "at least one layer"
        yield ("colour_linear", len(self.colour_linear) != 1,
               "no layers, or at least two: the pose joins at the second")
        yield ("direction", self.direction == "view" or self.direction_octaves >= 0,
               "view, or direction_octaves of at least 0")
        yield ("density_skip", 0 <= self.density_skip < len(self.density_layers),
               f"0, or a number below the {len(self.density_layers)} density layers")
        yield "grid_levels", 2 <= self.grid_levels <= 32, "a whole number from 2 to 32"
        yield "grid_features", self.grid_features in (2, 4, 8), "2, 4 or 8"
        yield ("grid_entries", self.grid_entries > 0 and self.grid_entries % self.grid_features == 0,
               "a multiple of grid_features")
        yield "grid_base", self.grid_base >= 2, "a whole number above 1"
        yield ("grid_finest", self.grid_finest > self.grid_base,
               f"a whole number above grid_base, {self.grid_base}")

    @property
    def dimension(self) -> int:
        """Number of coordinates: 3, or 4 for a point of the surface and l."""
        return 4 if self.coordinates == "surface" else 3

    def to_dict(self) -> dict[str, Any]:
        """The options as JSON values. Options that older files lack are left out at their defaults, so that
        digests of older presets stay the same."""
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in dataclasses.asdict(self).items()}
        return {k: v for k, v in values.items() if k not in _LATER or v != _LATER[k]}

    @classmethod
    def from_dict(cls, values: dict[str, Any], where: str = "preset") -> Preset:
        """The inverse of :meth:`to_dict`. Raises InputError for an option that does not exist."""
        return read_options(cls, rename_entries(values, PRESET_FIELDS, PRESET_VALUES), where)


#: Options that older files lack, and their defaults.
_LATER: dict[str, Any] = {"direction": "view", "pose_products": False}

PRESETS: dict[str, Preset] = {
    "fast": Preset(
        normal_octaves=1, direction_octaves=-1, pose_products=True, grid_features=4, grid_entries=2**18),
    "tiny": Preset(
        name="tiny", pose_layers=(8, 4), pose_products=True, deformation_layers=(8,), deformation_octaves=2,
        grid_levels=4, grid_entries=2**10, grid_base=8, grid_finest=32, density_layers=(16,), feature_width=8,
        colour_layers=(16,), direction_octaves=1, normal_octaves=0),
    "paper": Preset(
        name="paper", pose_layers=(256, 128), deformation_layers=(128,), deformation_octaves=10,
        deformation_scale=0.001, encoding="frequency", octaves=10, density_layers=(256,) * 7, density_skip=5,
        feature_width=0, colour_linear=(256, 256), colour_layers=(128,), direction_octaves=4,
        density_activation="relu", density_gain=1.0, density_bias=0.0, density_limit=10000.0,
        band_inside=0.08, band_fade=0.0),
}


def preset(name: str) -> Preset:
    """The preset of this name. Raises InputError, listing the names, for another."""
    if name not in PRESETS:
        raise InputError("preset", repr(name), "one of " + ", ".join(PRESETS))
    return PRESETS[name]
