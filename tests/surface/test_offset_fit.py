"""The mesh with offsets on spheres: what it is given is smaller than, or another shape than, what the images show."""

from __future__ import annotations

import copy
import dataclasses
import json

import numpy as np
import pytest
from sphere_capture import FRAMES, draw

from ndf_mi.errors import InputError
from ndf_mi.methods.mesh import TexturedMesh
from ndf_mi.methods.offset_mesh import OffsetMesh
from ndf_mi.surface import offset_fit
from ndf_mi.surface.degenerate import shapes, unsound
from ndf_mi.surface.offset_fit import OffsetFit
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.textured import TexturedSurface

RADIUS = 0.5


@pytest.fixture(scope="module")
def shrunk(capture):
    """The capture with a body of 0.45 m instead of 0.5 m."""
    body = dataclasses.replace(capture.body, template=0.9 * capture.body.template)
    vertices = capture.poses.vertices - 0.1 * capture.body.template
    return with_body(capture, body, dataclasses.replace(capture.poses, vertices=vertices))


def with_body(capture, body, poses):
    changed = copy.copy(capture)
    changed.body, changed.poses = body, poses
    return changed


def fitted(capture, steps: int = 80) -> tuple[np.ndarray, OffsetFit]:
    fit = OffsetFit(TexturedSurface(capture, 32), RestFrames(capture), capture, 32, 0.05, 2e-2, 0)
    fit.for_steps(steps)
    return fit.offsets(), fit


def assert_sound(capture, offsets: np.ndarray) -> None:
    rest, faces = RestFrames(capture).vertices, capture.body.faces
    assert not unsound(rest, offsets, faces).any()
    before, after = shapes(rest, faces), shapes(rest + offsets, faces)
    assert (after > 0.5 * before).all()


def test_recovers_the_radius(shrunk):
    # A pixel is 3 cm at the sphere; the training images show it from four sides.
    offsets, fit = fitted(shrunk)
    found = np.linalg.norm(shrunk.body.template + offsets, axis=1)
    assert found.mean() == pytest.approx(RADIUS, abs=3e-3)
    # Half a pixel: triangles that turn over on the way go back to where they were some steps before, and lose a little.
    assert np.percentile(np.abs(found - RADIUS), 90) < 0.015
    assert_sound(shrunk, offsets)
    assert fit.step() < 0.002


def test_recovers_a_bump(capture):
    centre = np.array([0.0, 0.0, RADIUS])
    distance = np.linalg.norm(capture.body.template - centre, axis=1, keepdims=True)
    bump = 0.2 * np.exp(-((distance / 0.25) ** 2)) * capture.body.template
    truth = {
        (name, frame): draw(capture.body, capture.poses.vertices[index] + bump.astype(np.float32), capture.cameras[name])
        for index, frame in enumerate(FRAMES[:2])
        for name in capture.splits["train"].cameras
    }
    changed = with_body(capture, capture.body, capture.poses)
    changed.image = lambda name, frame: truth[name, frame][0]
    changed.mask = lambda name, frame: truth[name, frame][1]
    offsets, _ = fitted(changed)
    outward = (offsets * capture.body.template).sum(1) / np.linalg.norm(capture.body.template, axis=1)
    assert outward[distance[:, 0] < 0.08].mean() == pytest.approx(0.095, abs=0.02)
    assert np.abs(outward[distance[:, 0] > 0.6]).mean() < 0.006
    assert_sound(changed, offsets)


@pytest.fixture(scope="module")
def trained(shrunk):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(offset_fit.mesh_fit, "SWEEP_STEPS", 12)
        mesh = OffsetMesh(shrunk, size=32, rate=0.05)
        mesh.fit(shrunk, seconds=4.0, seed=1)
    return mesh


def test_offsets_beat_the_texture_alone(shrunk, trained):
    bare = TexturedMesh(shrunk, size=32, rate=0.05)
    bare.fit(shrunk, seconds=2.0, seed=1)
    camera, truth = shrunk.cameras["n0"], shrunk.image("n0", 7)
    errors = [float(((mesh.render(camera, 7) - truth) ** 2).mean()) for mesh in (trained, bare)]
    assert errors[0] < 0.5 * errors[1]


def test_facts(trained):
    facts = trained.facts()
    assert set(facts["offset_sweep"]) == {f"{rate:g}" for rate in offset_fit.OFFSET_RATES}
    assert min(facts["offset_sweep"], key=facts["offset_sweep"].get) == f"{facts['offset_rate']:g}"
    lengths = 1000 * np.linalg.norm(trained.offsets, axis=1)
    assert facts["offset_median_mm"] == pytest.approx(np.median(lengths)) and facts["offset_median_mm"] > 20
    assert facts["offset_max_mm"] == pytest.approx(lengths.max())
    assert facts["budget"] == 4.0 and facts["steps"] > 5 and not facts["sweep"]


def test_saved_and_loaded_renders_the_same(shrunk, trained, tmp_path):
    trained.save(tmp_path)
    loaded = OffsetMesh.load(tmp_path, shrunk)
    camera = shrunk.cameras["n0"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert json.dumps(loaded.facts()) == json.dumps(trained.facts())
    assert loaded.fingerprint() == trained.fingerprint()
    loaded.offsets = 0 * loaded.offsets
    assert loaded.fingerprint() != trained.fingerprint()
    with pytest.raises(InputError, match="mesh.json"):
        TexturedMesh.load(tmp_path, shrunk)


def test_a_mesh_without_offsets_is_refused(shrunk, tmp_path):
    TexturedMesh(shrunk, size=8, rate=0.1).save(tmp_path)
    with pytest.raises(InputError, match="mesh.json"):
        OffsetMesh.load(tmp_path, shrunk)


def test_same_seed_same_offsets(shrunk):
    surface, rest = TexturedSurface(shrunk, 16), RestFrames(shrunk)
    results = []
    for seed in (3, 3, 4):
        fit = OffsetFit(surface, rest, shrunk, 16, 0.05, 4e-3, seed)
        fit.for_steps(3)
        results.append(fit.offsets())
    np.testing.assert_allclose(results[0], results[1], atol=1e-5)
    assert np.abs(results[0] - results[2]).max() > 1e-4
