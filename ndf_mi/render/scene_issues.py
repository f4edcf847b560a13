"""Checks scenes with `ndf` media for what Mitsuba's integrators would silently render wrongly."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import trimesh

from ndf_mi.mitsuba_mesh import triangles
from ndf_mi.render.performers import FieldMedium, lets_light_in, misread
from ndf_mi.render.shell import band_points

BLIND = (
    "PathIntegrator", "DirectIntegrator", "PRBIntegrator", "BasicPRBIntegrator", "PathProjectiveIntegrator",
    "DirectProjectiveIntegrator", "EmissionProjectiveIntegrator", "PTracerIntegrator",
    "ParticleTracerIntegrator", "DepthIntegrator", "BasicVolumetricPrimitiveRadianceFieldIntegrator",
)
"""Integrators that know surfaces only: to them a shell, which has no surface of its own, does not exist."""

OWN = ("NDFPath", "NDFQuadrature")
"""The package's integrators. To them the performer is where the band is, whatever encloses it, and they
refuse what they cannot show."""

OPEN = ("Rectangle", "Disk", "Cylinder", "BSplineCurve", "LinearCurve")
"""Shapes that enclose nothing."""

POINTS = 4096
"""Points of the band that a shape is tested to contain."""

DIRECTIONS = ((1.0, 0.0, 0.0), (0.48, -0.6, 0.64))
"""Directions of the lines along which they are tested."""

MOST_HITS = 256
"""Surfaces followed along a ray before the test gives up."""


def scene_issues(scene: mi.Scene) -> list[str]:
    """What renders wrongly and silently: one or two sentences for each issue, with the repair.

    - a shape without a surface and without a medium, such as an `ndf_shell` that was given a run alone;
    - an integrator that ignores media, by itself or within another (`aov`, `moment`);
    - a run whose colours hold the light of its capture, under an integrator that adds the scene's lights to
      it;
    - a shape around an `ndf` medium that is not closed, faces inward, shows a surface of its own, or leaves
      out part of the band;
    - shapes around two performers that meet;
    - a sensor inside such a shape that names no medium, or is used by `prbvolpath`, which begins outside of
      media.

    Under the package's own integrators only the first is an issue: they do not track media by surfaces, and
    warn of albedos themselves.
    """
    found = _empty_shapes(scene)
    holders = [shape for shape in scene.shapes()
               if isinstance(shape.interior_medium(), FieldMedium) and shape.interior_medium().outermost]
    kinds = _integrators(scene)
    if not holders or (kinds and all(kind & set(OWN) for kind in kinds)):
        return found
    for name in sorted(set().union(*kinds) & set(BLIND)):
        found.append(f"integrator: {name} knows no media, and shows nothing of the `ndf` media. Use "
                     "`volpath`, `volpathmis`, `prbvolpath` or one of this package.")
    for run in dict.fromkeys(shape.interior_medium().neural_field.run for shape in holders):
        reason = misread(run, scattering=True)
        if reason is not None and kinds:
            found.append(f"{run.path}: {reason}.")
    for shape in holders:
        found += _shape_issues(scene, shape)
    for one, other in itertools.combinations(holders, 2):
        found += _meeting(scene, one, other)
    prb = any("PRBVolpathIntegrator" in kind for kind in kinds)
    for number, sensor in enumerate(scene.sensors()):
        found += _sensor_issues(scene, number, sensor, holders, prb)
    return found


def open_edges(vertices: np.ndarray, faces: np.ndarray) -> int:
    """How many directed edges of a mesh, vertices (V, 3) and faces (F, 3), have no opposite one, where
    vertices at the same place count as one; 0 for a closed mesh, also where more than two triangles share an
    edge (trimesh's `is_watertight` calls that open)."""
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    edges = trimesh.geometry.faces_to_edges(same.reshape(-1)[faces])
    ahead = trimesh.graph.edges_to_coo(edges, data=np.ones(len(edges), np.int64)).tocsr()
    return int(abs(ahead - ahead.T).sum()) // 2


def contains(scene: mi.Scene, shape: mi.Shape, points: np.ndarray) -> np.ndarray:
    """Whether points (N, 3) are inside a shape of a scene: whether its first surface along a line, past all
    others, faces away.

    Points that seem outside are tested again along another line: where two shapes' surfaces cross, a ray that
    passes one may miss the other.
    """
    inside = np.zeros(len(points), dtype=bool)
    for direction in DIRECTIONS:
        rest = np.flatnonzero(~inside)
        if len(rest):
            inside[rest] = _faced_from_within(scene, shape, points[rest], direction)
    return inside


def _faced_from_within(
    scene: mi.Scene, shape: mi.Shape, points: np.ndarray, direction: tuple[float, float, float]
) -> np.ndarray:
    ray = mi.Ray3f(mi.Point3f(points.astype(np.float32).T), mi.Vector3f(*direction))
    inside = dr.full(mi.Bool, False, len(points))
    active = dr.full(mi.Bool, True, len(points))
    wanted = mi.ShapePtr(shape)
    for _ in range(MOST_HITS):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        own = active & (si.shape == wanted)
        inside |= own & (dr.dot(si.n, ray.d) > 0)
        active &= ~own
        ray = si.spawn_ray(ray.d)
        dr.eval(ray, inside, active)
        if not dr.any(active):
            break
    return inside.numpy()


def _integrators(scene: mi.Scene) -> list[set[str]]:
    """Class names, in Python and in C++, of the scene's integrator, or of those that it passes rays on to."""
    if scene.integrator() is None:
        return []
    hierarchy = mi.traverse(scene.integrator()).hierarchy
    found = {node: parent for node, (parent, _) in hierarchy.items() if isinstance(node, mi.Integrator)}
    within = [node for node in found if not any(parent is node for parent in found.values())]
    return [{type(node).__name__, node.class_name()} for node in within]


def _empty_shapes(scene: mi.Scene) -> list[str]:
    every, null = int(mi.BSDFFlags.All), int(mi.BSDFFlags.Null)
    return [f"shape {shape.id()!r}: has neither a surface (its BSDF is null) nor a medium, so that nothing "
            "of it is seen. Give it an `ndf` medium as its interior: an `ndf_shell` only encloses one."
            for shape in scene.shapes()
            if shape.bsdf() is not None and int(shape.bsdf().flags()) & every == null
            and shape.interior_medium() is None and shape.exterior_medium() is None
            and not shape.is_emitter() and not shape.is_sensor()]


def _meeting(scene: mi.Scene, one: Any, other: Any) -> list[str]:
    """An issue where points on one of two shapes are inside the other."""
    if not one.bbox().overlaps(other.bbox()):
        return []
    for shape, around in ((one, other), (other, one)):
        u = np.random.default_rng(0).random((2, POINTS), dtype=np.float32)
        points = shape.sample_position(0.0, mi.Point2f(u)).p.numpy().T
        if contains(scene, around, points).any():
            return [f"shapes {one.id()!r} and {other.id()!r}: meet. As Mitsuba keeps one medium at a time "
                    "along a ray, one of the performers is missing there. Move one of them by its medium's "
                    "`offset`, or use `ndf_path`."]
    return []


def _shape_issues(scene: mi.Scene, shape: Any) -> list[str]:
    name = f"shape {shape.id()!r}"
    field = shape.interior_medium().neural_field
    found: list[str] = []
    if not lets_light_in(shape.bsdf()):
        found.append(f"{name}: has a surface of its own (BSDF {shape.bsdf().class_name()}), which hides the "
                     "medium. Give it <bsdf type=\"null\"/>.")
    if shape.class_name() in OPEN:
        return [*found, f"{name}: a {shape.class_name()} encloses nothing. Use a closed shape, such as an "
                        "`ndf_shell`."]
    mesh = triangles(shape)
    edges = 0 if mesh is None else open_edges(*mesh)
    if edges:
        return [*found, f"{name}: is not closed ({edges} open edges), so that light enters its medium "
                        "unnoticed, or never leaves it. Close the mesh, or use an `ndf_shell`."]
    model, vertices = field.run.model, dr.detach(field.vertices).numpy().reshape(-1, 3)
    preset = model.field.preset
    points = band_points(model.surface, vertices, preset.band, preset.band_inside, POINTS, bands=model.bands)
    outside = ~contains(scene, shape, points)
    sample = field.posed().fused(mi.Point3f(points.astype(np.float32).T), mi.Vector3f(0.0, 0.0, 1.0))
    missing = outside & (sample.sigma.numpy() > 0)
    if missing.all():
        found.append(f"{name}: contains nothing of the field, or faces inward. Reverse the mesh's triangles, "
                     "or use an `ndf_shell`.")
    elif missing.any():
        x, y, z = (f"{v:.3f}" for v in points[missing][0])
        found.append(f"{name}: leaves out {100 * missing.mean():.2g} % of the field, for instance ({x}, {y}, "
                     f"{z}), which is not seen. Use an `ndf_shell` of the same run and frame, and load the "
                     "scene again if the body has moved.")
    return found


def _sensor_issues(
    scene: mi.Scene, number: int, sensor: mi.Sensor, holders: list[Any], prb: bool
) -> list[str]:
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    origin = np.array(ray.o, dtype=np.float64).reshape(3, -1)[:, :1].T
    inside = [shape for shape in holders if contains(scene, shape, origin)[0]]
    if not inside:
        return []
    where = f"sensor {number} is inside the medium of shape {inside[0].id()!r}"
    if prb:
        return [f"{where}, but `prbvolpath` begins outside of media: what lies between it and the next shell "
                "is not seen. Use `volpath`, or move the sensor."]
    if sensor.get_medium() is None:
        return [f"{where}, but names no medium: what lies between it and the next shell is not seen. Give "
                "the medium an id, and the sensor <ref id=\"…\"/>."]
    return []
