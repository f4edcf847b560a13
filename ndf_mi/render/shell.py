"""Closed meshes around the band of a posed body, so that ray tracing skips the empty space around it and inside it.

Regions are sets of a grid's cells. A mesh is cut by marching cubes from a function on the grid's nodes that is negative at all eight
corners of every cell of the region: marching cubes leaves such cells whole inside, so that the mesh contains the region by construction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.projection import PosedSurface, Surface

PARTS = 2
"""Samples of the distance along each side of a cell; the band is told from them in cubes of a cell's side over this."""

CHUNK = 1 << 20
"""Samples whose distances are looked for at once."""

LARGEST = 1 << 28
"""Samples of the distance at most: a gigabyte of them, and some more to work with."""

LEAST = 0.2
"""Least absolute value at a node of the function that a mesh is cut from, whose largest is 1: with it, a mesh keeps at least
LEAST / (1 + LEAST) of an edge's length away from every node."""


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
        """Cells that cover a box, its corners (3,) in metres, and one more on every side."""
        low = np.asarray(low, np.float64) - cell
        nx, ny, nz = (int(n) for n in np.ceil((np.asarray(high, np.float64) + cell - low) / cell))
        return cls(low, cell, (nx, ny, nz))

    def index(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """The cells of points (N, 3) as three arrays of integers; points outside count to the cell of the border next to them."""
        at = np.floor((points - self.low) / self.cell).astype(np.int64)
        return tuple(np.clip(at[:, k], 0, self.shape[k] - 1) for k in range(3))


@dataclass(frozen=True)
class Lattice:
    """Signed distances at the middles of the :data:`PARTS`³ parts of every cell.

    Attributes:
        grid: the cells.
        distance: (PARTS·nx, PARTS·ny, PARTS·nz) float32 l in metres, infinite where |l| is beyond the reach.
        places: flat indices, into the above, of the finite ones.
    """

    grid: Grid
    distance: np.ndarray
    places: np.ndarray

    def points(self, places: np.ndarray) -> np.ndarray:
        """(N, 3) float32 positions of flat indices."""
        x = _middle(mi.UInt32(places), self.distance.shape, mi.Point3f(*(float(v) for v in self.grid.low)), self.grid.cell / PARTS)
        return np.ascontiguousarray(x.numpy().T)

    def band_cells(self, band: float, inside: float) -> np.ndarray:
        """The cells that the band −`inside` <= l <= `band` can touch, (nx, ny, nz) bool.

        |l| changes by no more than the way between two points. A part of a cell, whose corners are r away from its middle, therefore
        holds no point of the band if |l| > `band` + r there; nor if l < −(`inside` + r), provided that l keeps its sign in it. The sign
        changes at that depth only where the body runs into itself: a part next to one outside the body is not taken as inside.
        """
        r = 0.5 * math.sqrt(3.0) * self.grid.cell / PARTS
        l = self.distance
        deep = l < -(inside + r)
        deep &= ~spread((l > 0) & (l < np.inf))
        return reduce_parts((np.abs(l) <= band + r) & ~deep, np.logical_or)

    def at_nodes(self, band: float, inside: float) -> np.ndarray:
        """About how far the grid's nodes are outside the band, (nx + 1, ny + 1, nz + 1) float32 metres, negative inside."""
        outside = np.maximum(np.minimum(self.distance, 2 * band) - band, -self.distance - inside)
        outside = np.where(np.isfinite(self.distance), outside, band)
        padded = np.pad(outside, 1, mode="edge")
        total = np.zeros([n + 1 for n in self.grid.shape], dtype=np.float32)
        for i in (0, 1):
            for j in (0, 1):
                for k in (0, 1):
                    total += padded[i::PARTS, j::PARTS, k::PARTS][: total.shape[0], : total.shape[1], : total.shape[2]]
        return total / 8


def lattice(surface: Surface, vertices: mi.Float, band: float, cell: float, grid: Grid | None = None) -> Lattice:
    """Looks for the closest points of the body around its band.

    Args:
        surface: the body's triangles.
        vertices: flat (3·V) posed positions in metres.
        band: the band's half width in metres.
        cell: the grid's spacing in metres.
        grid: a grid made before, to look on again; `cell` is then the grid's.

    Raises:
        InputError: the cells are too small for the body, which would take gigabytes.
    """
    cell = cell if grid is None else grid.cell
    reach = band + math.sqrt(3.0) * cell / PARTS
    with dr.suspend_grad():
        posed = PosedSurface(surface, dr.detach(vertices), reach)
        if grid is None:
            grid = Grid.around(posed.bbox.min.numpy().ravel(), posed.bbox.max.numpy().ravel(), cell)
        shape = tuple(PARTS * n for n in grid.shape)
        if math.prod(shape) > LARGEST:
            least = cell * (math.prod(shape) / LARGEST) ** (1 / 3)
            many = f"{cell:g} m, which makes {' × '.join(map(str, grid.shape))} cells"
            raise InputError("cell", many, f"at least {least:.2g} m around this body")
        distance = np.full(shape, np.inf, dtype=np.float32)
        places = []
        low, step = mi.Point3f(*(float(v) for v in grid.low)), cell / PARTS
        for start in range(0, distance.size, CHUNK):
            index = dr.arange(mi.UInt32, min(CHUNK, distance.size - start)) + dr.opaque(mi.UInt32, start)
            index = dr.gather(mi.UInt32, index, dr.compress(posed.may_contain(_middle(index, shape, low, step))))
            if not len(index):
                continue
            x = _middle(index, shape, low, step)
            found = posed.project(x)
            dr.eval(found.l, found.valid)
            some = found.valid.numpy()
            where = index.numpy()[some]
            distance.reshape(-1)[where] = found.l.numpy()[some]
            places.append(where)
    return Lattice(grid, distance, np.concatenate(places))


def reduce_parts(array: np.ndarray, combine: np.ufunc) -> np.ndarray:
    """An array over the parts of cells combined, by a ufunc of two arguments, into one over cells."""
    for axis in range(3):
        rows = np.moveaxis(array, axis, 0)
        result = rows[0::PARTS]
        for part in range(1, PARTS):
            result = combine(result, rows[part::PARTS])
        array = np.moveaxis(result, 0, axis)
    return np.ascontiguousarray(array)


def corners_of(cells: np.ndarray) -> np.ndarray:
    """The largest value of the up to eight cells around each node: (nx + 1, ny + 1, nz + 1), of what (nx, ny, nz) is; values from 0 on."""
    array = np.pad(cells, 1)
    for axis in range(3):
        rows = np.moveaxis(array, axis, 0)
        array = np.moveaxis(np.maximum(rows[:-1], rows[1:]), 0, axis)
    return np.ascontiguousarray(array)


def spread(cells: np.ndarray) -> np.ndarray:
    """The largest value of each entry and its up to 26 neighbours; values from 0 on."""
    return np.ascontiguousarray(corners_of(corners_of(cells))[1:-1, 1:-1, 1:-1])


def cut(inside: np.ndarray, smooth: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The boundary of the region around a grid's nodes.

    Args:
        inside: (nx + 1, ny + 1, nz + 1) bool; no node of the grid's border.
        smooth: of the same shape, about how far a node is from the boundary, in cells, negative inside. It moves the mesh between nodes
            and decides nothing: where its sign is wrong or it is small, `LEAST` is taken.

    Returns:
        vertices (N, 3) float32 and faces (M, 3) uint32: closed, normals pointing out. It crosses only cells with corners of both kinds.
    """
    from skimage.measure import marching_cubes  # here, since registering the plugins must not import it

    size = np.clip(np.where(inside, -smooth, smooth), LEAST, 1.0)
    value = np.where(inside, -size, size).astype(np.float32)

    corners, faces, _, _ = marching_cubes(value, 0.0, spacing=(grid.cell,) * 3, gradient_direction="descent")
    return (corners + grid.low).astype(np.float32), faces.astype(np.uint32)


def band_shell(
    surface: Surface, vertices: mi.Float, band: float, cell: float = 0.0125, inside: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The boundary of a region that contains every point of the band of a posed body, −`inside` <= l <= `band`.

    Where the body is thicker than twice `inside`, the boundary has an inner part too, around what lies deeper. Outside the band it
    keeps within two cells.

    Args:
        surface: the body's triangles.
        vertices: flat (3·V) posed positions in metres.
        band: how far the band reaches outside, in metres.
        cell: the grid's spacing in metres.
        inside: how far it reaches into the body, in metres; by default as far as outside.

    Returns:
        vertices (N, 3) float32 and faces (M, 3) uint32, closed, normals pointing out of the region.

    Raises:
        InputError: as by :func:`lattice`.
    """
    inside = band if inside is None else inside
    sampled = lattice(surface, vertices, band, cell)
    nodes = corners_of(sampled.band_cells(band, inside))
    return cut(nodes, sampled.at_nodes(band, inside) / cell, sampled.grid)


def band_points(surface: Surface, vertices: np.ndarray, band: float, inside: float, count: int, seed: int = 0) -> np.ndarray:
    """(count, 3) random points off the body along its triangles' normals, −`inside` <= offset <= `band`; nearly all lie in its band.

    Args:
        surface: the body's triangles.
        vertices: (V, 3) posed positions in metres.
        band, inside: metres.
    """
    rng = np.random.default_rng(seed)
    faces = surface.faces.numpy().reshape(-1, 3)
    corners = vertices[faces[rng.integers(len(faces), size=count)]].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    weights = rng.dirichlet((1, 1, 1), count)
    return (weights[:, None] @ corners)[:, 0] + normal * rng.uniform(-inside, band, (count, 1))


def _middle(index: mi.UInt32, shape: tuple[int, ...], low: mi.Point3f, step: float) -> mi.Point3f:
    """Positions of a lattice's flat indices, the last axis fastest."""
    ny, nz = (dr.opaque(mi.UInt32, n) for n in shape[1:])
    row = index // nz
    at = mi.Point3f(mi.Float(row // ny), mi.Float(row % ny), mi.Float(index - row * nz))
    return low + (at + 0.5) * dr.opaque(mi.Float, step)
