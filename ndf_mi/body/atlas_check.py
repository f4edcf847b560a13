"""Atlases and their quality: number of charts, flipped and overlapping triangles, distortion.

Signs of areas are exact for coordinates that are multiples of 2⁻²⁴ in [0, 1], such as those of
`atlas.one_piece`: their differences have 25 bits and the products 50, so that float64 does not round.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh

from ndf_mi.body import atlas_flatten
from ndf_mi.body import atlas_mesh as mesh

_CHUNK = 200_000


@dataclass(frozen=True, eq=False)
class Atlas:
    """Texture coordinates of a surface.

    Attributes:
        uv: (U, 2) float32 in [0, 1].
        uv_faces: (F, 3) int32 into ``uv``, corner by corner with the triangles of the surface.
    """

    uv: np.ndarray
    uv_faces: np.ndarray


@dataclass(frozen=True)
class AtlasReport:
    """The quality of an atlas. Distortion is measured at the scale of equal areas.

    Attributes:
        components: connected components of the surface.
        charts: connected components in the plane.
        flipped: triangles that are flipped or have no area in the plane.
        overlaps: pairs of triangles whose interiors intersect.
        covered: the sum of the triangles' areas as a fraction of the unit square.
        seam_length: length of the edges that are open in the plane but not on the surface, in the vertices'
            unit.
        energy: mean over the surface of (σ₁² + σ₂² + σ₁⁻² + σ₂⁻²)/4; 1 for an isometry.
        area_stretch: σ₁σ₂, a triangle's area in the plane relative to the surface: 1st, 50th, 99th
            percentile.
        anisotropy: σ₁/σ₂, at least 1: 50th, 99th percentile.
    """

    components: int
    charts: int
    flipped: int
    overlaps: int
    covered: float
    seam_length: float
    energy: float
    area_stretch: tuple[float, float, float]
    anisotropy: tuple[float, float]

    @property
    def valid(self) -> bool:
        """Whether each component is one chart without flips and overlaps."""
        return self.charts == self.components and self.flipped == self.overlaps == 0


def check_atlas(vertices: np.ndarray, faces: np.ndarray, atlas: Atlas) -> AtlasReport:
    """Measures the quality of any atlas.

    Args:
        vertices: (V, 3), the surface.
        faces: (F, 3), of an oriented manifold; every triangle has an area.
        atlas: texture coordinates, corner by corner with ``faces``.

    Raises:
        InputError: ``faces`` are not an oriented manifold.
    """
    points, flat = np.asarray(vertices, np.float64), np.asarray(atlas.uv, np.float64)
    faces, corners = np.asarray(faces, np.int64), np.asarray(atlas.uv_faces, np.int64)
    opposite = mesh.opposites(faces)
    cut = open_edges(corners, opposite)
    at_corners = points[faces].reshape(-1, 3)
    own = np.arange(faces.size).reshape(-1, 3)
    signed, true = trimesh.triangles.cross(flat[corners]) / 2, trimesh.triangles.area(points[faces])
    covered = np.abs(signed).sum()
    edge = np.nonzero(cut & (opposite > np.arange(len(opposite))))[0]
    scaled = flat[corners].reshape(-1, 2) * np.sqrt(true.sum() / covered)
    sigma = atlas_flatten.stretches(at_corners, own, scaled)
    with np.errstate(divide="ignore", invalid="ignore"):
        area, ratio = sigma.prod(1), sigma[:, 0] / sigma[:, 1]
    low, middle, high = _percentiles(area, true, (1, 50, 99))
    usual, worst = _percentiles(ratio, true, (50, 99))
    return AtlasReport(
        components=int(mesh.components(opposite).max()) + 1,
        charts=int(mesh.components(opposite, cut).max()) + 1,
        flipped=int((signed <= 0).sum()),
        overlaps=len(overlapping(flat[corners])),
        covered=float(covered),
        seam_length=float(np.linalg.norm(at_corners[edge] - at_corners[mesh.following(edge)], axis=1).sum()),
        energy=atlas_flatten.symmetric_dirichlet(at_corners, own, scaled),
        area_stretch=(low, middle, high),
        anisotropy=(usual, worst),
    )


def open_edges(corners: np.ndarray, opposite: np.ndarray) -> np.ndarray:
    """(3F,) bool: half-edges whose triangles have different UVs ``corners``, (F, 3), along them."""
    names = corners.ravel()
    h = np.nonzero(opposite >= 0)[0]
    cut = np.zeros(len(names), bool)
    across = opposite[h]
    cut[h] = (names[h] != names[mesh.following(across)]) | (names[mesh.following(h)] != names[across])
    return cut


def _percentiles(values: np.ndarray, weights: np.ndarray, percents: tuple[float, ...]) -> list[float]:
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    places = np.searchsorted(share, np.array(percents) / 100).clip(0, len(order) - 1)
    return values[order[places]].tolist()


def overlapping(corners: np.ndarray) -> np.ndarray:
    """The pairs of triangles, (P, 2), whose interiors intersect; triangles without area overlap nothing.

    Two convex polygons are disjoint if and only if a line along an edge of one of them separates them.
    Triangles that touch at a corner or along an edge do not overlap.

    Args:
        corners: (F, 3, 2) float64 in [0, 1], of either orientation.
    """
    signed = trimesh.triangles.cross(corners)
    ordered = np.where((signed < 0)[:, None, None], corners[:, ::-1], corners)
    found = [np.zeros((0, 2), np.int64)]
    for pairs in _candidates(ordered, np.nonzero(signed != 0)[0]):
        for begin in range(0, len(pairs), _CHUNK):
            some = pairs[begin : begin + _CHUNK]
            one, other = ordered[some[:, 0]], ordered[some[:, 1]]
            found.append(some[~_separated(one, other) & ~_separated(other, one)])
    return np.unique(np.sort(np.concatenate(found), axis=1), axis=0)


def _separated(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(P,) whether an edge of each counter-clockwise triangle, (P, 3, 2), has the other on its right."""
    along = np.roll(one, -1, axis=1) - one
    to = other[:, None] - one[:, :, None]
    side = along[:, :, None, 0] * to[..., 1] - along[:, :, None, 1] * to[..., 0]
    return (side <= 0).all(2).any(1)


def _candidates(corners: np.ndarray, chosen: np.ndarray) -> Iterator[np.ndarray]:
    """Pairs of the chosen triangles whose boxes intersect. A triangle is stored in the grid whose cells are
    just as large, in up to four of them, and compared with the triangles in its own and in every coarser
    grid."""
    low, high = corners[chosen].min(1), corners[chosen].max(1)
    level = np.clip(-np.ceil(np.log2(np.maximum((high - low).max(1), 2.0**-24))), 0, 24).astype(np.int64)
    for at in np.unique(level):
        coarse, fine = np.nonzero(level == at)[0], np.nonzero(level >= at)[0]
        one, first = _cells(low[coarse], high[coarse], at)
        other, second = _cells(low[fine], high[fine], at)
        order = np.argsort(first, kind="stable")
        begin, end = (np.searchsorted(first[order], second, side) for side in ("left", "right"))
        count = end - begin
        place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
        a, b = coarse[one[order[place]]], fine[np.repeat(other, count)]
        meet = (low[a] < high[b]).all(1) & (low[b] < high[a]).all(1) & ((a < b) | (level[b] > at))
        yield np.unique(np.stack([chosen[a[meet]], chosen[b[meet]]], axis=1), axis=0)


def _cells(low: np.ndarray, high: np.ndarray, level: int) -> tuple[np.ndarray, np.ndarray]:
    """The triangle and key of every cell of size 2^-level that a box, no larger than it, touches."""
    first, last = (np.floor(x * 2.0**level).astype(np.int64) for x in (low, high))
    x = np.stack([first[:, 0], last[:, 0], first[:, 0], last[:, 0]], axis=1)
    y = np.stack([first[:, 1], first[:, 1], last[:, 1], last[:, 1]], axis=1)
    return np.repeat(np.arange(len(low)), 4), (x * (1 << 32) + y).ravel()
