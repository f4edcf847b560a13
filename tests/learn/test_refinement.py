"""Refinement in trainings: a known error of a camera is found, stopped trainings continue exactly, and what
cannot be refined is refused."""

import copy
import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.body.poses import Poses
from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.camera_corrections import corrected
from ndf_mi.learn.corrections import Corrections
from ndf_mi.learn.loop import resume, start
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.refined import refined_camera
from ndf_mi.learn.refinement import INITIAL
from ndf_mi.learn.step import QuadratureStep
from ndf_mi.learn.trainer import Trainer
from ndf_mi.run import Run

TINY = dataclasses.replace(preset("tiny"), band_inside=0.08)
OPTIONS = TrainingOptions(surface="body", steps=250, rays=256, samples=24, seed=4, learning_rate=1e-2,
                          grid_rate=5e-2, refine_after=50, refine_outlines=0, pose_noise=0.0, held_back=0.0)


def taken(trainer, steps):
    for _ in range(steps):
        trainer.step()
    return trainer


def with_camera(capture, camera):
    changed = copy.copy(capture)
    changed.cameras = capture.cameras | {camera.name: camera}
    return changed


def pointing_error(camera, truth):
    """Pixels between where the ball's centre is seen by a camera and by the true one."""
    return np.linalg.norm(camera.project(np.zeros((1, 3))) - truth.project(np.zeros((1, 3))))


@pytest.mark.long
def test_a_known_error_of_a_camera_is_found(capture, tmp_path):
    """By a field that was trained with the true cameras: one in training could take the shape that a single
    wrong camera sees of a ball."""
    trained = taken(start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, steps=120)), 120)
    truth = capture.cameras["c1"]
    wrong = corrected(truth, np.radians([1.0, 0.7, 0.0]), np.array([0.0, 0.01, 0.0]), 0.0)
    assert pointing_error(wrong, truth) > 1
    options = dataclasses.replace(OPTIONS, refine=("cameras",))
    trainer = start(tmp_path / "wrong", with_camera(capture, wrong), TINY, options)
    step = QuadratureStep(trained.run, options, None, trainer.refinement)
    optimiser, rng = trainer.optimisers["cameras"], np.random.default_rng(0)
    for number in range(80):
        loss, _ = step(trained.parameters.detached(), trainer.batches(rng, False, False),
                       Corrections(cameras=optimiser["cameras"]))
        dr.backward(loss)
        optimiser.set_learning_rate(0.15 * 0.05 ** (number / 80))
        optimiser.step()
    trainer.save()
    run = Run.load(tmp_path / "wrong")
    assert pointing_error(refined_camera(run, wrong), truth) < 0.4 * pointing_error(wrong, truth)
    assert refined_camera(run, capture.cameras["n0"]) is capture.cameras["n0"]


def test_a_killed_training_ends_at_the_corrections_of_an_uninterrupted_one(capture, tmp_path):
    options = dataclasses.replace(OPTIONS, steps=12, refine=("cameras",), camera_colours=True, refine_after=4,
                                  camera_rate=0.02)
    whole = taken(start(tmp_path / "whole", capture, TINY, options), 12)
    half = taken(start(tmp_path / "half", capture, TINY, options), 7)
    half.save()
    taken(half, 2)  # steps that are lost when the process is killed
    again = taken(resume(tmp_path / "half", capture), 5)
    for name, value in whole.corrections.groups().items():
        found = np.asarray(again.corrections.groups()[name])
        assert np.abs(np.asarray(value)).max() > 0.02
        np.testing.assert_allclose(found, value, atol=2e-3)


def test_nothing_moves_before_it_may(capture, tmp_path):
    options = dataclasses.replace(OPTIONS, refine=("cameras",), camera_colours=True)
    refined = taken(start(tmp_path / "refined", capture, TINY, options), 5)
    for value in refined.corrections.groups().values():
        assert (np.asarray(value) == 0).all()
    plain = taken(start(tmp_path / "plain", capture, TINY, OPTIONS), 5)
    assert refined.progress.error == pytest.approx(plain.progress.error, rel=1e-4)
    assert plain.corrections.groups() == {} and plain.run.surface_tensors == {}
    assert list(plain.optimisers) == ["weights", "grid"]


@pytest.fixture(scope="module")
def skinned_capture(capture):
    """The capture with a body of one joint, and in its second training frame 40 mm beside the performer."""
    count = len(capture.body.template)
    body = dataclasses.replace(
        capture.body, joints=np.zeros((1, 3)), joint_names=("ball",), parents=np.array([-1]),
        weights=np.ones((count, 1)), shape_dirs=capture.body.template[..., None],
        joint_dirs=np.zeros((1, 3, 1)), shape_names=("size",))
    shift = np.array([[0, 0, 0], [0.03, -0.02, 0.02], [0, 0, 0]])
    poses = dataclasses.replace(capture.poses, vertices=capture.poses.vertices + shift[:, None],
                                translation=capture.poses.translation + shift, shape=np.zeros(1))
    return capture.with_body(body, poses)


@pytest.mark.long
def test_a_wrong_place_is_found_and_stays_found(capture, skinned_capture, tmp_path):
    options = dataclasses.replace(OPTIONS, refine=("pose",), pose_rate=0.1, refine_frames=0.0)
    trainer = taken(start(tmp_path / "run", skinned_capture, TINY, options), 250)
    trainer.save()
    row, run = 1, Run.load(tmp_path / "run")

    def error(poses):
        """How far the second frame is off relative to the first: a common shift is the field's to absorb."""
        off = (poses.vertices - capture.poses.vertices).mean(1)
        return np.linalg.norm(off[row] - off[0])

    assert error(run.poses) < 0.45 * error(skinned_capture.poses)
    np.testing.assert_allclose(run.poses.vertices[row].mean(0) - skinned_capture.poses.vertices[row].mean(0),
                               run.surface_tensors["refined.translation"][1], atol=2e-3)
    np.testing.assert_array_equal(run.poses.vertices[2], skinned_capture.poses.vertices[2])
    # Training goes on from the fit as it was given, not from the corrected one.
    again = resume(tmp_path / "run", skinned_capture)
    np.testing.assert_array_equal(again.refinement.poses.vertices, skinned_capture.poses.vertices)
    np.testing.assert_allclose(again.run.poses.vertices, run.poses.vertices, atol=1e-6)


def test_training_goes_on_from_what_was_registered(skinned_capture, tmp_path):
    options = dataclasses.replace(OPTIONS, refine=("pose", "cameras"), refine_outlines=3, steps=2)
    trainer = start(tmp_path / "run", skinned_capture, TINY, options)
    trainer.save()
    run = Run.load(tmp_path / "run")
    moved = run.poses.vertices - skinned_capture.poses.vertices
    assert np.abs(moved[1]).max() > 0.01 and not moved[2].any()
    np.testing.assert_allclose(moved[1].mean(0), run.surface_tensors["registered.translation"][1], atol=2e-3)
    np.testing.assert_array_equal(run.surface_tensors["refined.translation"], np.zeros((2, 3)))
    np.testing.assert_array_equal(Poses.read(run.path / INITIAL, run.body).vertices, run.poses.vertices)
    # Rays are those of the cameras that the run is rendered with.
    camera = refined_camera(run, skinned_capture.cameras["c1"])
    assert np.abs(camera.transform - skinned_capture.cameras["c1"].transform).max() > 1e-4
    for each in (trainer, resume(run.path, skinned_capture)):
        batch = each.batches(np.random.default_rng(0), False, False)
        origin = batch.origin[:, np.flatnonzero(batch.camera == 1)[0]]
        np.testing.assert_allclose(origin, camera.position, atol=1e-6)


def test_the_loss_has_the_gradients_of_differences(skinned_capture, tmp_path):
    options = dataclasses.replace(OPTIONS, refine=("pose", "shape", "cameras"), camera_colours=True,
                                  min_transmittance=0.0, skip_empty=False, rays=1024, refine_prior=0.01)
    trainer = start(tmp_path / "run", skinned_capture, TINY, options)
    batch = trainer.batches(np.random.default_rng(0), False, False)
    step = QuadratureStep(trainer.run, options, None, trainer.refinement)
    rng = np.random.default_rng(1)
    at = {name: 0.1 * rng.normal(size=len(value)) for name, value in trainer.refinement.initial().items()}

    def loss(values, attached=False):
        found = {name: mi.Float(value.astype(np.float32)) for name, value in values.items()}
        if attached:
            dr.enable_grad(*found.values())
        total, _ = step(trainer.run.parameters, batch, Corrections(**found))
        if attached:
            dr.backward(total)
            return {name: np.asarray(dr.grad(value), np.float64) for name, value in found.items()}
        return float(total[0])

    gradients = loss(at, attached=True)
    # A shape also changes the box, and with it where candidates lie, which gradients do not see.
    for name in ("pose", "cameras", "colours"):
        gradient = gradients[name]
        along = gradient / np.linalg.norm(gradient)
        size = 0.05
        high, low = (loss(at | {name: at[name] + s * along}) for s in (size, -size))
        assert (high - low) / (2 * size) == pytest.approx(gradient @ along, rel=0.05), name


def test_steps_that_know_no_corrections_see_them_in_frozen_batches(skinned_capture, tmp_path):
    options = dataclasses.replace(OPTIONS, refine=("pose", "shape", "cameras"), skip_empty=False,
                                  refine_prior=0.0)
    trainer = start(tmp_path / "run", skinned_capture, TINY, options)
    batch = trainer.batches(np.random.default_rng(0), False, False)
    step = QuadratureStep(trainer.run, options, None, trainer.refinement)
    rng = np.random.default_rng(1)
    corrections = Corrections(**{name: mi.Float(rng.normal(size=len(value)).astype(np.float32))
                                 for name, value in trainer.refinement.initial().items()})
    plain = float(step(trainer.run.parameters, batch)[0][0])
    expected = float(step(trainer.run.parameters, batch, corrections)[0][0])
    trainer.refinement.publish(corrections)
    frozen = trainer.refinement.frozen(corrections, batch)
    found = float(QuadratureStep(trainer.run, options, None)(trainer.run.parameters, frozen)[0][0])
    assert found == pytest.approx(expected, rel=1e-4) and expected != pytest.approx(plain, rel=1e-3)


@pytest.mark.parametrize("names", [("hands",), ("pose", "pose")])
def test_unknown_and_repeated_names_are_refused(names):
    with pytest.raises(InputError, match="refine"):
        TrainingOptions(refine=names)


@pytest.mark.parametrize("name", ["pose", "shape"])
def test_a_body_without_skinning_is_refused(capture, tmp_path, name):
    options = dataclasses.replace(OPTIONS, refine=(name,))
    run = Run.create(tmp_path / "run", TINY, capture.body, capture.poses, 1, background=[0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="without skinning"):
        Trainer(run, capture, options)
