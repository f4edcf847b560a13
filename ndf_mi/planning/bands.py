"""How wide the band must be at each place of the body, from where masks and bodies disagree."""

from __future__ import annotations

import math

import numpy as np
import trimesh
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ndf_mi.field import Preset
from ndf_mi.planning.standoff import REACH, Disagreement, Standoff

#: Distance on the body at rest in metres over which disagreement is pooled. A ray passes the body at a place
#: next to that whose cloth or hair it shows.
RADIUS = 0.05
#: How fast widths may change over the body, metres a metre. The distance from the body changes by at most one
#: metre a metre, so that the band's edge stays a graph over the surface, and its fade is nearly as smooth as
#: in a band of one width.
SLOPE = 0.5
#: Smallest widths, metres: poses that were not seen move cloth and skin by that much.
LEAST = 0.015
#: Transmittance at which a performer counts as opaque; sets how deep the density must reach.
TRANSPARENT = 1e-3
#: Share of the band, from the body outwards, in which training does not penalise density. The surface must
#: lie within.
USABLE = 0.8
#: Steps of distance in metres that costs are summed in.
_STEP = 0.002


def widths(outside: np.ndarray, inside: np.ndarray, half: float, full: Preset) -> np.ndarray:
    """(N, 2) how far the band must reach outside and inside, in metres, for what reaches `outside` and
    `inside` of the body.

    Pixels blur outlines by half their width, `half`, to either side, and the field must reproduce that along
    their rays. A band is at most as deep as it is wide, and no deeper than that of the full model is wide.
    """
    band = (np.maximum(outside, half) + half) / USABLE
    opaque = math.log(1 / TRANSPARENT) / full.density_limit / (1 - full.band_fade)
    deep = np.minimum(inside + half + opaque, full.band)
    return np.stack([np.maximum(band, deep / USABLE), deep], axis=1)


def place_bands(rest: np.ndarray, faces: np.ndarray, found: Standoff, allowed_error: float, half: float,
                full: Preset, residual: np.ndarray | None = None) -> np.ndarray:
    """The widths that the band needs at each vertex.

    Around each vertex, disagreeing pixels of all frames and cameras are pooled. The width there covers all
    but some that cost in proportion to the neighbourhood's area. All that is left out costs no more than
    `allowed_error` a mask pixel. Widths then change over the body by at most :data:`SLOPE`: the wide places
    widen what is around them.

    What a ray shows is at least as far off as the ray is. A place that no camera has seen at the outline has
    the width that its surroundings give it.

    Args:
        rest: (V, 3) the body at rest, metres.
        faces: (F, 3).
        found: disagreeing pixels of the same body.
        allowed_error: squared error in sRGB.
        half: half a pixel's width in metres.
        full: the model that the widths are for.
        residual: (V,) by how much the body is known to be off its surface, in metres, on whichever side.

    Returns:
        (V, 2) float32 metres outside and inside, at most :data:`REACH` and a little more for blur.
    """
    rest = np.asarray(rest, np.float64)
    area = _vertex_areas(rest, faces)
    near = _neighbourhoods(rest)
    share, allowed = (near @ area) / max(area.sum(), 1e-30), allowed_error * found.pixels
    off = 0 if residual is None else np.maximum(residual, 0)
    outside, inside = (np.minimum(np.maximum(_reach(part, faces, near, share, allowed), off), REACH)
                       for part in (found.outside, found.inside))
    needed = np.maximum(widths(outside, inside, half, full), LEAST)
    spread = np.stack([spread_out(rest, faces, width) for width in needed.T], axis=1)
    # Spreading may leave a place deeper than what is not penalised outside of it.
    spread[:, 0] = np.maximum(spread[:, 0], spread[:, 1] / USABLE)
    return spread.astype(np.float32)


def spread_out(rest: np.ndarray, faces: np.ndarray, width: np.ndarray, slope: float = SLOPE) -> np.ndarray:
    """(V,) the smallest widths, at least those given, that change along the mesh's edges by at most `slope`
    times the length."""
    edges = trimesh.geometry.faces_to_edges(faces)
    drop = slope * np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    width = np.array(width, np.float64)
    while True:
        one, other = width[edges[:, 0]] - drop, width[edges[:, 1]] - drop
        wider = width.copy()
        np.maximum.at(wider, edges[:, 1], one)
        np.maximum.at(wider, edges[:, 0], other)
        if (wider <= width + 1e-9).all():
            return wider
        width = wider


def _reach(part: Disagreement, faces: np.ndarray, near: csr_array, share: np.ndarray,
           allowed: float) -> np.ndarray:
    """(V,) distances beyond which all pixels together cost at most `allowed`, those around each vertex in
    proportion to its `share` (V,) of the area."""
    count = len(share)
    placed = part.triangle >= 0
    bins = math.ceil(REACH / _STEP) + 1
    at = np.minimum(np.ceil(part.distance[placed] / _STEP).astype(np.int64), bins - 1)
    corners = faces[part.triangle[placed]].astype(np.int64)
    cost = np.bincount((corners * bins + at[:, None]).ravel(), np.repeat(part.cost[placed] / 3, 3),
                       minlength=count * bins).reshape(count, bins)
    beyond = np.cumsum((near @ cost)[:, ::-1], axis=1)[:, ::-1]
    reach = np.zeros(count)
    # Most neighbourhoods have nothing to leave out. The others may have several times their shares.
    for times in np.geomspace(4096, 1, 25):
        # The last step at which more than allowed lies there or beyond.
        reach = np.where(beyond > times * allowed * share[:, None], np.arange(bins) * _STEP, 0).max(axis=1)
        left_out = part.distance[placed] > reach[corners].mean(axis=1)
        if part.cost[placed][left_out].sum() <= allowed:
            break
    return reach


def _neighbourhoods(rest: np.ndarray) -> csr_array:
    """(V, V) 1 where two vertices are within :data:`RADIUS`."""
    tree = cKDTree(rest)
    pairs = tree.query_pairs(RADIUS, output_type="ndarray")
    own = np.arange(len(rest))
    row, column = (np.concatenate([pairs[:, a], pairs[:, 1 - a], own]) for a in (0, 1))
    return csr_array((np.ones(len(row), np.float32), (row, column)), shape=(len(rest), len(rest)))


def _vertex_areas(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) a third of the area of the triangles around each vertex, square metres."""
    a, b, c = (rest[corner] for corner in faces.T)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return np.bincount(faces.ravel(), np.repeat(area / 3, 3), minlength=len(rest))
