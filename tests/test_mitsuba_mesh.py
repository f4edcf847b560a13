"""Meshes built and moved through `mitsuba_mesh`, seen by Mitsuba's own ray casting."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.mitsuba_mesh import make_mesh, set_faces, set_vertices, triangles

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def hit(scene: mi.Scene, x: float, y: float) -> mi.SurfaceInteraction3f:
    """Where a ray towards -z from height 5 meets the scene."""
    return scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 5), mi.Vector3f(0, 0, -1)))


def test_counter_clockwise_triangles_face_the_viewer() -> None:
    found = hit(mi.load_dict({"type": "scene", "square": make_mesh("square", SQUARE, FACES)}), 0.25, 0.5)
    np.testing.assert_allclose(np.ravel(found.n), [0, 0, 1], atol=1e-6)
    turned = hit(mi.load_dict({"type": "scene", "square": make_mesh("square", SQUARE, FACES[:, ::-1])}), 0.25,
                 0.5)
    np.testing.assert_allclose(np.ravel(turned.n), [0, 0, -1], atol=1e-6)


def test_texture_coordinates_and_attributes_are_interpolated() -> None:
    mesh = make_mesh("square", SQUARE, FACES, uv=SQUARE[:, :2] * [1, 0.5],
                     attributes={"vertex_height": SQUARE[:, 1:2] + 3})
    found = hit(mi.load_dict({"type": "scene", "square": mesh}), 0.25, 0.5)
    np.testing.assert_allclose(np.ravel(found.uv), [0.25, 0.25], atol=1e-6)
    assert mesh.eval_attribute_1("vertex_height", found)[0] == pytest.approx(3.5)


@pytest.mark.parametrize(("smooth", "shading"), [(False, (0, 0, 1)), (True, (0.5**0.5, 0, 0.5**0.5))])
def test_vertex_normals_of_smooth_meshes_follow_the_vertices(
    smooth: bool, shading: tuple[float, ...]
) -> None:
    """Two squares that meet at a right angle along x = 0: at the fold, the vertex normals lie halfway."""
    vertices = np.array([[-1, 0, 0], [0, 0, 0], [0, 1, 0], [-1, 1, 0], [0, 0, -1], [0, 1, -1]],
                        dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    flat = vertices.copy()
    flat[4:] = [[1, 0, 0], [1, 1, 0]]
    scene = mi.load_dict({"type": "scene", "fold": make_mesh("fold", flat, faces, smooth=smooth)})
    np.testing.assert_allclose(np.ravel(hit(scene, -1e-4, 0.25).sh_frame.n), [0, 0, 1], atol=1e-3)
    parameters = mi.traverse(scene)
    set_vertices(parameters, vertices, "fold")
    parameters.update()
    # Equal areas on both sides, but of four triangles two or one meet at each vertex.
    found = np.ravel(hit(scene, -1e-4, 0.5).sh_frame.n)
    np.testing.assert_allclose(found, shading, atol=0.25 if smooth else 1e-3)
    assert (found[0] > 0.3) == smooth


def test_props_carry_the_shape_s_bsdf_and_id() -> None:
    props = mi.Properties()
    props.set_id("shell")
    props["bsdf"] = mi.load_dict({"type": "null"})
    mesh = make_mesh("anything", SQUARE, FACES, props=props)
    assert mesh.id() == "shell" and mesh.bsdf().class_name() == "Null"


def test_moving_vertices_keeps_gradients() -> None:
    scene = mi.load_dict({"type": "scene", "square": make_mesh("square", SQUARE, FACES)})
    parameters = mi.traverse(scene)
    height = mi.Float(0.75)
    dr.enable_grad(height)
    raised = mi.Point3f(SQUARE.T) + mi.Vector3f(0, 0, 1) * height
    set_vertices(parameters, dr.ravel(raised), "square")
    parameters.update()
    found = hit(scene, 0.25, 0.5)
    assert found.t[0] == pytest.approx(4.25)
    dr.backward(found.t)
    assert dr.grad(height)[0] == pytest.approx(-1)


def test_triangles_are_read_as_they_were_set() -> None:
    mesh = make_mesh("square", SQUARE, FACES)
    parameters = mi.traverse(mesh)
    set_vertices(parameters, 2 * SQUARE)
    set_faces(parameters, FACES[::-1])
    parameters.update()
    found = triangles(mesh)
    assert found is not None
    np.testing.assert_array_equal(found[0], 2 * SQUARE)
    np.testing.assert_array_equal(found[1], FACES[::-1])


def test_shapes_of_other_plugins() -> None:
    cube = triangles(mi.load_dict({"type": "cube"}))
    assert cube is not None and cube[1].shape == (12, 3)
    assert triangles(mi.load_dict({"type": "sphere"})) is None
