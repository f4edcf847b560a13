"""Silhouettes against the masks of the capture's own renderer."""

from __future__ import annotations

import numpy as np
import pytest
from sphere_capture import FRAMES

from ndf_mi.surface.silhouettes import Silhouettes, agreement


def test_silhouettes_are_the_masks_of_the_same_mesh(capture):
    caster = Silhouettes(capture.body.faces, capture.poses.vertices[0])
    for row, frame in enumerate(FRAMES[:2]):
        caster.set_vertices(capture.poses.vertices[row])
        camera = capture.cameras["c1"]
        silhouette, mask = caster.silhouette(camera), capture.mask("c1", frame)
        assert silhouette.sum() > 300
        assert np.count_nonzero(silhouette != mask) < 0.02 * silhouette.sum()  # 64 samples against one


def test_a_ray_that_ends_before_the_mesh_does_not_meet_it(capture):
    camera = capture.cameras["c0"]
    caster = Silhouettes(capture.body.faces, capture.poses.vertices[0])
    middle = camera.project(np.zeros((1, 3)))
    nearest = np.linalg.norm(camera.position) - 0.5
    assert caster.hits(camera, middle, np.array([nearest + 0.01])).all()
    assert not caster.hits(camera, middle, np.array([nearest - 0.01])).any()
    assert not caster.hits(camera, np.array([[0.5, 0.5]])).any()


def test_agreement_is_the_mean_intersection_over_union():
    one = np.array([[True, True, False, False]])
    other = np.array([[False, True, True, False]])
    assert agreement([one, one], [other, one]) == pytest.approx((1 / 3 + 1) / 2)
    assert agreement([one], [~one]) == 0
    assert agreement([np.zeros((2, 2), bool)], [np.zeros((2, 2), bool)]) == 1


def test_a_mesh_beside_or_behind_the_camera_has_an_empty_or_a_whole_search(capture):
    camera = capture.cameras["c0"]
    right = np.asarray(camera.transform)[:3, 0]
    caster = Silhouettes(capture.body.faces, capture.body.template)
    caster.set_vertices(capture.body.template + 10 * right)
    assert not caster.silhouette(camera).any()
    caster.set_vertices(0.1 * capture.body.template + camera.position)  # the camera is inside
    assert caster.silhouette(camera).all()
