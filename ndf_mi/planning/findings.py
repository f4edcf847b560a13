"""From estimates to findings: question, figures, consequence, and what the model does without."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.poses import Poses
from ndf_mi.field import Preset
from ndf_mi.planning.appearance import Estimate
from ndf_mi.planning.bands import TRANSPARENT, USABLE
from ndf_mi.planning.detail import Detail
from ndf_mi.planning.plan import Finding, PlanSettings
from ndf_mi.planning.standoff import REACH, Standoff

#: Cells of the grid's finest level per pixel. Views and frames divide the body into pixels differently, so
#: together they show more than one of them. Cells as large as a pixel cost 0.3 to 0.9 dB; two per pixel are
#: no better than this.
_CELLS = 1.5
#: Features of a grid vertex where no pose mixes them: one look of a place needs fewer than many.
_STATIC_FEATURES = 2
#: Share of a part's area below which it is reported as hardly seen.
_HARDLY_SEEN = 0.5


def worth(estimate: Estimate, settings: PlanSettings) -> float:
    """Decibels that the model loses if what was estimated is not modelled."""
    return _decibels(max(estimate.value, 0.0), settings)


def needed(estimate: Estimate, settings: PlanSettings) -> bool:
    """Whether the estimate is significant and worth a part of the model."""
    return estimate.significant and worth(estimate, settings) > settings.worth


def articulation(poses: Poses, rows: list[int]) -> float:
    """Motion of the body's vertices in metres, apart from rigid motion.

    The 95th percentile over vertices of their root mean square distance from their mean over these rows.
    """
    turns = Rotation.from_rotvec(poses.root_rotation[rows].astype(np.float64)).as_matrix()
    centred = poses.vertices[rows] - poses.translation[rows, None].astype(np.float64)
    local = np.einsum("tvi,tij->tvj", centred, turns)
    deviation = np.sqrt(((local - local.mean(axis=0)) ** 2).sum(axis=2).mean(axis=0))
    return float(np.quantile(deviation, 0.95))


def about_light(estimate: Estimate, settings: PlanSettings, full: Preset) -> Finding:
    """Does shading follow the surface as it turns in the world?"""
    keep = needed(estimate, settings)
    return Finding(
        "light", "does shading follow the surface's normal as the performer turns?",
        _evidence(estimate, settings, "the turning of the normal explains", "frames",
                  "nothing turns, or there are too few frames to see it"),
        "the world-space normal enters the colour" if keep else "colours stay with the surface",
        "" if keep else "the normal's inputs", _figures(estimate, settings),
        {"normal_octaves": full.normal_octaves if keep else -1})


def about_view(estimate: Estimate, settings: PlanSettings, full: Preset) -> Finding:
    """Do colours change with the view?"""
    keep = needed(estimate, settings)
    return Finding(
        "view", "does appearance change with the view?",
        _evidence(estimate, settings, "highlights by the mirrored direction explain", "cameras",
                  "this needs three cameras"),
        "the view direction, mirrored by the normal, enters the colour" if keep
        else "a part of the surface has one colour from everywhere",
        "" if keep else "the view branch", _figures(estimate, settings),
        {"direction_octaves": full.direction_octaves if keep else -1,
         "direction": full.direction if keep else "view"})


def about_pose(moved: float, frame: Estimate, within: Estimate, detail: Detail, settings: PlanSettings,
               full: Preset) -> Finding:
    """One pose or many, and does appearance change with it?

    Args:
        moved: motion of the body in metres, apart from rigid motion.
        frame, within: what frames explain in all, and within patches.
    """
    many = moved > detail.footprint / 2
    keep = many and needed(frame, settings)
    deform = keep and needed(within, settings)
    evidence = (f"apart from rigid motion the body moves by {1e3 * moved:.0f} mm, and half a pixel spans "
                f"{500 * detail.footprint:.0f} mm: ")
    evidence += "many poses. " if many else "one pose, which can explain nothing. "
    evidence += _evidence(frame, settings, "cameras agree on what frames change:", "",
                          "this needs two frames and two cameras")
    if keep:
        share = min(max(within.value / frame.value, 0.0), 1.0)
        evidence += f"; within {100 * share:.0f} % of it something moves along the surface"
    both = "pose features and the deformation net"
    left_out = "" if deform else "the deformation net" if keep else both
    follows = both if deform else "pose features" if keep else "one field for all frames"
    return Finding(
        "pose", "one pose or many, and does appearance follow the pose?", evidence, follows, left_out,
        {"moved_mm": 1e3 * moved, **_figures(frame, settings), "within": _number(within.value),
         "within_error": _number(within.error)},
        {"pose_layers": full.pose_layers if keep else (), "pose_products": keep and full.pose_products,
         "grid_features": full.grid_features if keep else _STATIC_FEATURES,
         "deformation_layers": full.deformation_layers if deform else ()})


def about_band(found: Standoff, detail: Detail, settings: PlanSettings, full: Preset,
               local: np.ndarray | None = None, least: float = 0.0) -> Finding:
    """How far does the performer stand off the reference surface, the body of the capture that is planned?

    Args:
        local: (V, 2) metres that each vertex needs outside and inside.
        least: metres that the performer may stand off where no mask shows it.
    """
    allowed = settings.allowed_error * found.pixels
    shown, inside = found.outside.reach(allowed), found.inside.reach(allowed)
    outside = max(shown, least)
    # Pixels blur outlines by half their width to either side, and the field must reproduce that along their
    # rays. Without room for it, tight clothes under pixels of 24 mm lost 0.9 dB outside and 0.3 to 0.5 dB
    # inside.
    half = detail.footprint / 2
    band = _ceil((max(outside, half) + half) / USABLE)
    deep = _ceil(inside + half + math.log(1 / TRANSPARENT) / full.density_limit / (1 - full.band_fade))
    # A band is at most as deep as it is wide. Occluders and badly fitted bodies are no reason to widen it.
    deep = min(deep, full.band)
    driven, band = _ceil(deep / USABLE) > band, max(band, _ceil(deep / USABLE))
    evidence = (f"masks reach {1e3 * shown:.0f} mm beyond the surface and the surface "
                f"{1e3 * inside:.0f} mm beyond the masks, ignoring what costs less than {settings.worth:g} "
                f"dB; a pixel spans {1e3 * detail.footprint:.0f} mm, and its blur reaches half of that "
                "further")
    if outside > shown:
        evidence += f"; where masks do not show the surface it may be {1e3 * least:.0f} mm off"
    if outside >= REACH:
        evidence += f"; distances above {1e3 * REACH:.0f} mm were not measured"
    if driven:
        evidence += "; the band's outer part follows from its inner one"
    before, after = full.band + full.band_inside, band + deep
    follows = f"a band from {1e3 * deep:.0f} mm inside to {1e3 * band:.0f} mm outside the surface"
    figures: dict[str, float | None] = {"outside_mm": 1e3 * shown, "inside_mm": 1e3 * inside}
    if local is not None:
        wide, depth = np.median(np.minimum(local, [band, deep]), axis=0)
        follows += (f"; half of the vertices would need no more than from {1e3 * depth:.0f} mm to "
                    f"{1e3 * wide:.0f} mm (bands=local)")
        figures |= {"median_outside_mm": 1e3 * float(wide), "median_inside_mm": 1e3 * float(depth)}
    return Finding(
        "band", "how far does the performer stand off the reference surface?", evidence, follows,
        f"of {1e3 * before:.0f} mm, {1e3 * (before - after):.0f}" if after < before else "", figures,
        {"band": band, "band_inside": deep})


def about_detail(detail: Detail, settings: PlanSettings, full: Preset) -> Finding:
    """How much detail is there, and over how much of the texture's square?"""
    blur = max((factor for factor, lost in detail.lost.items() if lost < settings.allowed_error), default=1)
    finest = _CELLS / max(detail.uv_footprint * blur, 1e-9)
    finest = int(np.clip(8 * math.ceil(finest / 8), 2 * full.grid_base, full.grid_finest))
    growth = math.log(full.grid_finest / full.grid_base) / (full.grid_levels - 1)
    levels = int(np.clip(1 + round(math.log(finest / full.grid_base) / growth), 2, full.grid_levels))
    # More entries than the finest level has cells on the performer are useless.
    cells = detail.atlas * finest**2 * max(math.ceil(finest * full.grid_l_scale), 1)
    entries = int(min(full.grid_entries, 2 ** math.ceil(math.log2(max(cells, 2**10)))))
    evidence = (f"a pixel spans {1e3 * detail.footprint:.1f} mm, {detail.uv_footprint:.4f} of the texture's "
                f"square; a blur by two pixels would cost {_decibels(detail.lost[2], settings):.2f} dB; "
                f"noise is at most {detail.noise:.4f}; "
                f"training images show {100 * detail.seen:.0f} % of the body's area, "
                f"{100 * detail.atlas:.0f} % of the square")
    hardly_seen = sorted((share, name) for name, share in detail.parts.items() if share < _HARDLY_SEEN)
    if hardly_seen:
        evidence += "; of these less than half: " + ", ".join(
            f"{name} ({100 * share:.0f} %)" for share, name in hardly_seen)
    fewer = full.grid_levels - levels
    smaller = [(fewer > 0, f"{fewer} level{'' if fewer == 1 else 's'}"),
               (finest < full.grid_finest, f"cells below {1e3 * detail.footprint * blur / _CELLS:.0f} mm"),
               (entries < full.grid_entries, "entries for what is never seen")]
    return Finding(
        "detail", "how much detail is there, and which parts are ever seen?", evidence,
        f"a grid of {levels} levels up to {finest} cells a side, {entries:,} entries a level",
        _listed([part for is_so, part in smaller if is_so]),
        {"footprint_mm": 1e3 * detail.footprint, "uv_footprint": detail.uv_footprint, "noise": detail.noise,
         "seen": detail.seen, "atlas": detail.atlas,
         **{f"blur_{factor}": lost for factor, lost in detail.lost.items()},
         **{f"seen_{name}": share for name, share in detail.parts.items()}},
        {"grid_finest": finest, "grid_levels": levels, "grid_entries": entries})


def about_scattering(lighting: str | None) -> Finding:
    """Is the light known?"""
    known = lighting is not None
    return Finding(
        "scattering", "is the light known?",
        f"capture.json names the scene of the light, {lighting}" if known else "capture.json names no light",
        "emission and absorption; --integrator prbvolpath can learn density and albedo instead" if known
        else "emission and absorption",
        "" if known else "scattering: without the light, albedo cannot be separated from it",
        {"known": float(known)}, {})


def about_colour(changes: dict[str, Any], full: Preset) -> Finding | None:
    """Does anything but the place enter the colour? If not, the colour network is left out; else None."""
    if changes["pose_layers"] or changes["direction_octaves"] >= 0 or changes["normal_octaves"] >= 0:
        return None
    return Finding("colour", "does anything but the place enter the colour?",
                   "neither pose, nor view, nor normal does",
                   "the colour comes from the density network's last hidden layer", "the colour network", {},
                   {"colour_layers": (), "feature_width": 0})


def _evidence(estimate: Estimate, settings: PlanSettings, explains: str, held_out: str, unknown: str) -> str:
    if not math.isfinite(estimate.error):
        return unknown
    where = f" in {held_out} that were not fitted" if held_out else ""
    verdict = "" if estimate.significant else ", which is not significant"
    if estimate.value < -2 * estimate.error:
        verdict += " (the fit follows errors of the geometry and makes other images worse)"
    return (f"{explains} {1e4 * estimate.value:.2f} ± {1e4 * estimate.error:.2f} ·10⁻⁴ of the squared error"
            f"{where}{verdict}: {worth(estimate, settings):.2f} dB at {settings.accuracy:g} dB")


def _figures(estimate: Estimate, settings: PlanSettings) -> dict[str, float | None]:
    return {"explained": _number(estimate.value), "error": _number(estimate.error),
            "worth_db": worth(estimate, settings)}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _decibels(error: float, settings: PlanSettings) -> float:
    """The loss in dB if `error` is added to the expected mean squared error."""
    return float(10 * np.log10(1 + error / settings.expected_error))


def _listed(parts: list[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _ceil(metres: float) -> float:
    """Rounded up to a millimetre."""
    return math.ceil(1e3 * metres - 1e-6) / 1e3
