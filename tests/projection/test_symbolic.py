"""The same numbers in symbolic loops and inside a medium that `volpath` calls; a new pose compiles no kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import trimesh

from ndf_mi.projection import PosedSurface

RECORDS = 1 << 15


def test_in_a_symbolic_loop(mesh: Any, scatter: Callable, points: Callable) -> None:
    posed = mesh.pose(0.2)
    start, end = points(scatter(mesh, 300, 0.3, seed=11)), points(scatter(mesh, 300, 0.3, seed=12))
    steps = 8

    def step(i: mi.UInt32, total: mi.Float, uv: mi.Point2f) -> tuple[mi.UInt32, mi.Float, mi.Point2f]:
        p = posed.project(dr.lerp(start, end, mi.Float(i) / steps))
        return i + 1, total + dr.select(p.valid, p.l, 0), uv + dr.select(p.valid, p.uv, 0)

    state = (dr.zeros(mi.UInt32, 300), mi.Float(0), mi.Point2f(0))
    _, total, uv = dr.while_loop(state, lambda i, *_: i < steps, step, mode="symbolic")
    expected, expected_uv = mi.Float(0), mi.Point2f(0)
    for i in range(steps):
        p = posed.project(dr.lerp(start, end, mi.Float(i) / steps))
        expected += dr.select(p.valid, p.l, 0)
        expected_uv += dr.select(p.valid, p.uv, 0)
    np.testing.assert_allclose(np.asarray(total), np.asarray(expected), atol=2e-6)
    np.testing.assert_allclose(np.asarray(uv), np.asarray(expected_uv), atol=2e-4)


def test_inside_a_medium_under_volpath(mesh: Any) -> None:
    posed = mesh.pose(0.1)
    # the method is traced several times; what one trace has written, another must not read
    pool = [(dr.zeros(mi.Float, RECORDS * 8), dr.zeros(mi.UInt32, 1)) for _ in range(40)]
    written: list[tuple[mi.Float, mi.UInt32]] = []
    dr.eval(pool)

    class Recorder(mi.Medium):
        """Absorbs evenly in the band, and writes down what the projection gave."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return posed.bbox.ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.Color3f:
            return mi.Color3f(5.0)

        def get_scattering_coefficients(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> tuple:
            active = mi.Bool(active) & mei.is_valid()
            p = posed.project(mei.p, active)
            records, used = pool.pop()
            written.append((records, used))
            slot = dr.scatter_inc(used, mi.UInt32(0), active)
            row = [*mei.p, p.l, p.uv.x, p.uv.y, mi.Float(p.triangle), dr.select(p.valid, 1.0, 0.0)]
            for k, value in enumerate(row):
                dr.scatter(records, value, slot * 8 + k, active & (slot < RECORDS))
            sigma = dr.select(p.valid, mi.Color3f(4.0), 0)
            return 0.5 * sigma, 5.0 - sigma, sigma

    mi.register_medium("projection_recorder", Recorder)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 4},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, 0.3, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
            },
            "light": {"type": "constant"},
            "shell": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().scale(0.9),
                "bsdf": {"type": "null"},
                "interior": {"type": "projection_recorder"},
            },
        }
    )
    image = np.asarray(mi.render(scene, spp=4))
    assert np.isfinite(image).all() and image.min() < 0.9
    rows = np.concatenate([np.asarray(r).reshape(-1, 8)[: int(np.asarray(n)[0])] for r, n in written])
    assert len(rows) > 2000 and 0.05 < rows[:, 7].mean() < 0.95
    p = posed.project(mi.Point3f(np.ascontiguousarray(rows[:, :3].T)))
    valid = np.asarray(p.valid)
    np.testing.assert_array_equal(rows[:, 7] > 0, valid)
    np.testing.assert_allclose(rows[valid, 3], np.asarray(p.l)[valid], atol=1e-6)
    same = rows[valid, 6].astype(int) == np.asarray(p.triangle)[valid]
    # Closest to an edge or a vertex are all the triangles there, and roundings choose among them.
    corners = mesh.vertices[mesh.faces[rows[valid, 6].astype(int)[~same]]]
    off = rows[valid, :3][~same] - trimesh.triangles.closest_point(corners, rows[valid, :3][~same])
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), np.abs(rows[valid, 3][~same]), atol=1e-6)
    assert same.mean() > 0.9
    np.testing.assert_allclose(rows[valid, 4:6][same], np.asarray(p.uv).T[valid][same], atol=1e-5)


def test_gradient_reaches_the_vertices_inside_a_medium(mesh: Any) -> None:
    """The transmittance of an absorbing band, as the body grows: `prbvolpath` against a quadrature with 300
    steps."""
    surface, band, size, opaque = mesh.surface(), 0.15, 8, 8.4
    start = mi.Float(mesh.vertices.astype(np.float32).ravel())

    def absorption(posed: Any, x: mi.Point3f, active: mi.Bool | bool) -> mi.Float:
        p = posed.project(x, active)
        return dr.select(p.valid, 8 * dr.square(1 - dr.square(p.l / band)), 0)

    class Absorber(mi.Medium):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.vertices = mi.Float(start)
            dr.make_opaque(self.vertices)
            self.posed = PosedSurface(surface, self.vertices, band)

        def traverse(self, callback: Any) -> None:
            callback.put("vertices", self.vertices, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            self.posed = PosedSurface(surface, self.vertices, band)

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return self.posed.bbox.ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.Color3f:
            return mi.Color3f(opaque)

        def get_scattering_coefficients(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> tuple:
            sigma = mi.Color3f(absorption(self.posed, mei.p, active))
            return mi.Color3f(0), opaque - sigma, sigma

    mi.register_medium("projection_absorber", Absorber)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prbvolpath", "max_depth": 4, "rr_depth": 100},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, 0.3, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            },
            "light": {"type": "constant"},
            "shell": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().scale(0.95),
                "bsdf": {"type": "null"},
                "interior": {"type": "projection_absorber"},
            },
        }
    )
    parameters = mi.traverse(scene)
    key = "shell.interior_medium.vertices"
    scale = mi.Float(1)
    dr.enable_grad(scale)
    parameters[key] = start * scale
    parameters.update()
    image = mi.render(scene, parameters, spp=2048, seed=1)
    dr.backward(dr.mean(image.array))
    found = float(dr.grad(scale)[0])

    side, steps, first, last = 64, 300, 1.5, 4.5
    pixel = dr.arange(mi.UInt32, side * side)
    film = (mi.Point2f(mi.Float(pixel % side), mi.Float(pixel // side)) + 0.5) / side
    rays, _ = scene.sensors()[0].sample_ray(0.0, 0.0, film, mi.Point2f(0.5))
    index = dr.arange(mi.UInt32, side * side * steps)
    length = (last - first) / steps
    t = first + (mi.Float(index % steps) + 0.5) * length
    along = dr.gather(mi.Vector3f, rays.d, index // steps) * t
    x = dr.gather(mi.Point3f, rays.o, index // steps) + along

    scale = mi.Float(1)
    dr.enable_grad(scale)
    sigma = absorption(PosedSurface(surface, start * scale, band), x, dr.all(dr.abs(x) < 0.95))
    transmittance = dr.mean(dr.exp(-dr.block_sum(sigma, steps) * length))
    dr.backward(transmittance)
    assert abs(float(np.asarray(image).mean()) - float(transmittance[0])) < 0.01
    expected = float(dr.grad(scale)[0])
    assert expected < -0.3 and abs(found - expected) < 0.08 * abs(expected), (found, expected)


def test_a_new_pose_compiles_nothing(mesh: Any, scatter: Callable, points: Callable) -> None:
    surface = mesh.surface()

    def step(i: int) -> int:
        angle = 0.7 * i
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        vertices = mi.Float(((1 + 0.1 * i) * mesh.vertices @ turn.T).astype(np.float32).ravel())
        x = points(scatter(mesh, 5000 + 100 * i, 0.2, seed=i))
        dr.eval(vertices, x)
        dr.enable_grad(vertices, x)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            posed = PosedSurface(surface, vertices, 0.1 + 0.01 * i)
            p = posed.project(x)
            dr.backward(dr.sum(dr.select(p.valid, p.l + p.uv.x, 0)))
            dr.eval(dr.grad(vertices), dr.grad(x), p.l, p.uv)
            kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        hashes = {k["hash"] for k in kernels}
        new = len(hashes - seen)
        seen.update(hashes)
        return new

    seen: set[int] = set()
    counts = [step(i) for i in range(5)]
    assert counts[0] > 0 and counts[1:] == [0, 0, 0, 0], counts
