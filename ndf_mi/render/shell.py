"""Closed meshes around the band of a posed body, so that rays skip the empty space around and inside.

Regions are sets of a grid's cells. Marching cubes cuts a mesh from a function on the grid's nodes that is
negative at all eight corners of every cell of the region. It leaves such cells entirely inside, so that the
mesh contains the region by construction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.projection import Bands, PosedSurface, Surface

PARTS = 2
"""Samples of the distance along each side of a cell. Each sample decides whether its cube, a part of the
cell, touches the band."""

CHUNK = 1 << 20
"""Samples whose distances are computed at once."""

LARGEST = 1 << 28
"""Largest number of distance samples: a gigabyte of them, plus working memory."""

LEAST = 0.2
"""Smallest absolute value at a node of the function that a mesh is cut from; the largest is 1. A mesh thus
stays at least LEAST / (1 + LEAST) of an edge's length away from every node."""


@dataclass(frozen=True)
class Grid:
    """Cubic cells over a box.

    Attributes:
        low: (3,) float64 lower corner, metres.
        cell: the cells' side, metres.
        shape: cells along x, y and z.
    """

    low: np.ndarray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, low: np.ndarray, high: np.ndarray, cell: float) -> Grid:
        """Cells that cover a box, given by its corners (3,) in metres, and one more cell on every side."""
        low = np.asarray(low, np.float64) - cell
        nx, ny, nz = (int(n) for n in np.ceil((np.asarray(high, np.float64) + cell - low) / cell))
        return cls(low, cell, (nx, ny, nz))

    def index(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """The cells of points (N, 3) as three arrays of integers; points outside belong to the border."""
        at = np.floor((points - self.low) / self.cell).astype(np.int64)
        return tuple(np.clip(at[:, k], 0, self.shape[k] - 1) for k in range(3))


@dataclass(frozen=True)
class Local:
    """How the parts of a grid's cells lie relative to a band whose width varies over the body.

    Attributes:
        edge: (P,) float32, how far the centres of parts are outside the band in metres, negative in it; at
            the `places` of :class:`Distances`.
        touched: (PARTS·nx, PARTS·ny, PARTS·nz) bool, which parts the band can touch.
        shallow: of the same shape, which of these its part inside the body can touch.
    """

    edge: np.ndarray
    touched: np.ndarray
    shallow: np.ndarray


@dataclass(frozen=True)
class Distances:
    """Signed distances at the centres of the :data:`PARTS`³ parts of every cell.

    Attributes:
        grid: the cells.
        distance: (PARTS·nx, PARTS·ny, PARTS·nz) float32 l in metres, infinite where |l| is beyond the reach.
        places: flat indices, into the above, of the finite ones.
        local: how they lie relative to a band whose width varies; None for a band of one width.
    """

    grid: Grid
    distance: np.ndarray
    places: np.ndarray
    local: Local | None = None

    def points(self, places: np.ndarray) -> np.ndarray:
        """(N, 3) float32 positions of flat indices."""
        low = mi.Point3f(*(float(v) for v in self.grid.low))
        x = _centre(mi.UInt32(places), self.distance.shape, low, self.grid.cell / PARTS)
        return np.ascontiguousarray(x.numpy().T)

    def band_cells(self, band: float, inside: float) -> np.ndarray:
        """The cells that the band −`inside` <= l <= `band` can touch, (nx, ny, nz) bool. Where the band's
        width varies, it is taken from :class:`Local`.

        |l| changes by at most the distance between two points. A part of a cell, whose corners are r away
        from its centre, therefore holds no point of the band if |l| > `band` + r there; nor if
        l < −(`inside` + r), provided that l keeps its sign in it. At that depth the sign changes only where
        the body intersects itself, so a part next to one outside the body does not count as inside.
        """
        r = 0.5 * math.sqrt(3.0) * self.grid.cell / PARTS
        l = self.distance
        deep = l < -(inside + r) if self.local is None else (l < 0) & ~self.local.shallow
        deep &= ~spread((l > 0) & (l < np.inf))
        touched = np.abs(l) <= band + r if self.local is None else self.local.touched
        return reduce_parts(touched & ~deep, np.logical_or)

    def band_places(self, band: float, inside: float) -> np.ndarray:
        """Those of `places` that lie in the band."""
        l = self.distance.reshape(-1)[self.places]
        return self.places[(l <= band) & (l >= -inside) if self.local is None else self.local.edge <= 0]

    def at_nodes(self, band: float, inside: float) -> np.ndarray:
        """About how far the grid's nodes are outside the band, (nx + 1, ny + 1, nz + 1) float32 metres,
        negative inside."""
        if self.local is None:
            outside = np.maximum(np.minimum(self.distance, 2 * band) - band, -self.distance - inside)
            outside = np.where(np.isfinite(self.distance), outside, band)
        else:
            outside = np.full(self.distance.shape, band, np.float32)
            outside.reshape(-1)[self.places] = np.minimum(self.local.edge, band)
        padded = np.pad(outside, 1, mode="edge")
        total = np.zeros([n + 1 for n in self.grid.shape], dtype=np.float32)
        nx, ny, nz = total.shape
        for i, j, k in np.ndindex(2, 2, 2):
            total += padded[i::PARTS, j::PARTS, k::PARTS][:nx, :ny, :nz]
        return total / 8


def distances(surface: Surface, vertices: mi.Float, band: float, cell: float,
              bands: Bands | None = None) -> Distances:
    """Samples the distance from a posed body on a grid around its band.

    Args:
        vertices: flat (3·V) posed positions in metres.
        band: the band's half width in metres.
        cell: the grid's spacing in metres.
        bands: the widths where they vary; `band` then is the largest.

    Raises:
        InputError: the cells are so small that the body would take gigabytes.
    """
    diagonal = math.sqrt(3.0) * cell / PARTS
    with dr.suspend_grad():
        posed = PosedSurface(surface, dr.detach(vertices),
                             band + diagonal if bands is None else bands.widened(diagonal))
        grid = Grid.around(posed.bbox.min.numpy().ravel(), posed.bbox.max.numpy().ravel(), cell)
        shape = tuple(PARTS * n for n in grid.shape)
        if math.prod(shape) > LARGEST:
            least = cell * (math.prod(shape) / LARGEST) ** (1 / 3)
            many = f"{cell:g} m, which makes {' × '.join(map(str, grid.shape))} cells"
            raise InputError("cell", many, f"at least {least:.2g} m around this body")
        distance = np.full(shape, np.inf, dtype=np.float32)
        places, edges = [np.zeros(0, np.uint32)], [np.zeros(0, np.float32)]
        touched, shallow = (np.zeros(0 if bands is None else shape, bool) for _ in range(2))
        low, step = mi.Point3f(*(float(v) for v in grid.low)), cell / PARTS
        for start in range(0, distance.size, CHUNK):
            index = dr.arange(mi.UInt32, min(CHUNK, distance.size - start)) + dr.opaque(mi.UInt32, start)
            x = _centre(index, shape, low, step)
            if bands is None:
                near = posed.may_contain(x)
            else:
                near, inner = posed.within_bands(x, bands, diagonal / 2)
                # The box is tighter than leaves, which have one width, and ends before the grid.
                near &= posed.bbox.contains(x)
                dr.eval(near, inner)
                touched.reshape(-1)[index.numpy()], shallow.reshape(-1)[index.numpy()] = near, inner
            index = dr.gather(mi.UInt32, index, dr.compress(near))
            if not len(index):
                continue
            x = _centre(index, shape, low, step)
            found = posed.project(x)
            dr.eval(found.l, found.valid, found.band)
            some = found.valid.numpy()
            where = index.numpy()[some]
            distance.reshape(-1)[where] = found.l.numpy()[some]
            places.append(where)
            if bands is not None:
                outside, inside = (width.numpy()[some] - diagonal for width in found.band)
                l = found.l.numpy()[some]
                edges.append(np.maximum(l - outside, -l - inside))
    local = None if bands is None else Local(np.concatenate(edges), touched, shallow)
    return Distances(grid, distance, np.concatenate(places), local)


def reduce_parts(array: np.ndarray, combine: np.ufunc) -> np.ndarray:
    """Combines the parts of each cell, (PARTS·nx, PARTS·ny, PARTS·nz), by a ufunc of two arguments into (nx,
    ny, nz)."""
    nx, ny, nz = (n // PARTS for n in array.shape)
    parts = array.reshape(nx, PARTS, ny, PARTS, nz, PARTS)
    for axis in (5, 3, 1):
        parts = combine.reduce(parts, axis)
    return parts


def corners_of(cells: np.ndarray) -> np.ndarray:
    """The largest value among the up to eight cells around each node: from (nx, ny, nz) to (nx + 1, ny + 1,
    nz + 1); values >= 0."""
    array = np.pad(cells, 1)
    for axis in range(3):
        rows = np.moveaxis(array, axis, 0)
        array = np.moveaxis(np.maximum(rows[:-1], rows[1:]), 0, axis)
    return np.ascontiguousarray(array)


def spread(cells: np.ndarray) -> np.ndarray:
    """The largest value among each entry and its up to 26 neighbours; values >= 0."""
    return np.ascontiguousarray(corners_of(corners_of(cells))[1:-1, 1:-1, 1:-1])


def cut(inside: np.ndarray, smooth: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The boundary of the region around some of a grid's nodes.

    Args:
        inside: (nx + 1, ny + 1, nz + 1) bool; false at the grid's border.
        smooth: of the same shape; approximate distance of each node from the boundary in cells, negative
            inside. It only shifts the mesh between nodes: where its sign is wrong or it is small, `LEAST`
            replaces it.

    Returns:
        vertices (N, 3) float32 and faces (M, 3) uint32: closed, normals pointing out. The mesh crosses only
        cells that have corners of both kinds.
    """
    from skimage.measure import marching_cubes  # Registering the plugins must not import it.

    size = np.clip(np.where(inside, -smooth, smooth), LEAST, 1.0)
    value = np.where(inside, -size, size).astype(np.float32)

    corners, faces, _, _ = marching_cubes(value, 0.0, spacing=(grid.cell,) * 3, gradient_direction="descent")
    return (corners + grid.low).astype(np.float32), faces.astype(np.uint32)


def band_shell(
    surface: Surface, vertices: mi.Float, band: float, cell: float = 0.0125, inside: float | None = None,
    bands: Bands | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The boundary of a region that contains every point of the band of a posed body, −`inside` <= l <=
    `band`.

    Where the body is thicker than twice `inside`, the boundary has an inner part too, which leaves out what
    lies deeper. It extends at most two cells beyond the band.

    Args:
        vertices: flat (3·V) posed positions in metres.
        band: how far the band reaches outside, in metres.
        cell: the grid's spacing in metres.
        inside: how far it reaches into the body, in metres; `band` by default.
        bands: the widths where they vary; `band` and `inside` then are the largest.

    Returns:
        vertices (N, 3) float32 and faces (M, 3) uint32, closed, normals pointing out of the region.

    Raises:
        InputError: as by :func:`distances`.
    """
    inside = band if inside is None else inside
    sampled = distances(surface, vertices, band, cell, bands)
    nodes = corners_of(sampled.band_cells(band, inside))
    return cut(nodes, sampled.at_nodes(band, inside) / cell, sampled.grid)


def band_points(
    surface: Surface, vertices: np.ndarray, band: float, inside: float, count: int, seed: int = 0,
    bands: Bands | None = None,
) -> np.ndarray:
    """(count, 3) random points offset from the body along its triangles' normals, −`inside` <= offset <=
    `band`; nearly all lie in its band.

    Args:
        vertices: (V, 3) posed positions in metres.
        band, inside: metres.
        bands: the widths where they vary, instead of these.
    """
    import trimesh  # Registering the plugins must not import it.

    mesh = trimesh.Trimesh(vertices, surface.faces.numpy().reshape(-1, 3), process=False)
    rng = np.random.default_rng(seed)
    points, triangle = trimesh.sample.sample_surface(mesh, count, np.ones(len(mesh.faces)), seed=rng)
    if bands is None:
        along = rng.uniform(-inside, band, (count, 1))
    else:
        weights = trimesh.triangles.points_to_barycentric(mesh.triangles[triangle], points)
        width = np.einsum("nk,nkd->nd", weights, bands.widths[mesh.faces[triangle]])
        along = rng.uniform(-width[:, 1], width[:, 0])[:, None]
    return np.asarray(points + mesh.face_normals[triangle] * along)


def _centre(index: mi.UInt32, shape: tuple[int, ...], low: mi.Point3f, step: float) -> mi.Point3f:
    """Centres of the cubes with these flat indices, the last axis fastest."""
    ny, nz = (dr.opaque(mi.UInt32, n) for n in shape[1:])
    row = index // nz
    at = mi.Point3f(mi.Float(row // ny), mi.Float(row % ny), mi.Float(index - row * nz))
    return low + (at + 0.5) * dr.opaque(mi.Float, step)
