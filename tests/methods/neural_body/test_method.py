"""Neural Body on a sphere whose texture is known."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.field.sample import Located
from ndf_mi.methods.base import Budget
from ndf_mi.methods.neural_body import volume as volume_module
from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.method import FAST, PAPER, NeuralBody
from ndf_mi.methods.neural_body.volume import NeuralBodyVolume
from ndf_mi.methods.registry import entry
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.rays import RaySettings

SMALL = Architecture(
    voxel=0.031, padding=0.1, code=8, channels=(8, 8, 8), depths=(1, 1, 1), density_layers=(32,), latent=4,
    colour_width=16, position_octaves=2, direction_octaves=1, reach=1, activation="softplus", gain=100.0,
    bias=-4.0, limit=500.0)


class SmallBody(NeuralBody):
    presets = {"fast": dataclasses.replace(
        FAST, architecture=SMALL, surface="body", schedule=Schedule(steps=120, learning_rate=1e-2),
        rays=RaySettings(rays=256, samples=32, min_transmittance=1e-3))}


@pytest.fixture(scope="module")
def trained(capture):
    method, compiled = SmallBody(samples=48), []

    def watch(seconds, step, loss):
        if step == 80:
            dr.kernel_history_clear()
        if step == 110:
            compiled.extend(kernel["size"] for kernel in dr.kernel_history([dr.KernelType.JIT])
                            if not kernel["cache_hit"])

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        method.fit(capture, Budget(seed=1), watch)
    return method, compiled


def test_it_learns_views_and_poses_that_it_has_not_seen(capture, trained):
    method, _ = trained
    for camera, frame, most in (("n0", 2, 0.15), ("n1", 7, 0.25)):
        truth = capture.image(camera, frame)
        error = np.square(method.render(capture.cameras[camera], frame) - truth).mean()
        assert error < most * np.square(truth - capture.background).mean()


def test_nothing_is_compiled_once_warm(trained):
    # Samples are padded to one of a few numbers, of which one may not have come up before.
    assert len(set(trained[1])) <= 1


def test_a_scene_shows_it(capture, trained):
    method, _ = trained
    radiance = srgb_to_linear(capture.background).tolist()
    scene = mi.load_dict({
        "type": "scene", "performer": method.shape(7), "integrator": {"type": "ndf_path", "samples": 48},
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": radiance}}})
    camera = capture.cameras["n0"]
    image = mi.render(scene, sensor=mi.load_dict(camera.sensor(spp=16, sampler="multijitter")), spp=16)
    difference = np.abs(np.clip(linear_to_srgb(image.numpy()[..., :3]), 0, 1) - method.render(camera, 7))
    # A ray goes through the centre of a pixel there, and through 16 places of it here.
    assert np.median(difference) < 2e-3 and difference.mean() < 1e-2


def test_the_registry_knows_it(capture):
    method = entry("neural-body").create({"samples": 16, "texture": 3})
    assert isinstance(method, NeuralBody) and method.label == "Neural Body"
    assert entry("neural-body").create({"preset": "paper"}).preset.architecture == Architecture()


@pytest.mark.long
def test_the_published_sizes_train_and_render(capture):
    class Paper(NeuralBody):
        presets = {"paper": dataclasses.replace(
            PAPER, schedule=dataclasses.replace(PAPER.schedule, steps=3),
            rays=dataclasses.replace(PAPER.rays, rays=64, samples=16))}

    method = Paper("paper", samples=4)
    method.fit(capture, Budget(seed=1))
    known, vertices = method.metadata(), capture.poses.vertices.shape[1]
    assert known["steps"] == 3 and np.isfinite([row[2] for row in known["history"]]).all()
    # Codes, two latent codes, convolutions and networks.
    assert known["parameters"] == 16 * vertices + 2 * 128 + 3_790_592 + 431_364
    assert np.isfinite(method.render(capture.cameras["n0"], 7)).all()


def placed(capture, architecture=SMALL):
    volume = NeuralBodyVolume(capture, architecture)
    rng = np.random.default_rng(0)
    return volume, {name: mi.Float(value) for name, value in volume.initial(rng).items()}


def around(vertices, count=200):
    """Points within 5 cm of vertices."""
    rng = np.random.default_rng(1)
    return vertices[rng.integers(len(vertices), size=count)] + rng.uniform(-0.05, 0.05, (count, 3))


def evaluated(posed, points):
    active = mi.Bool(np.ones(len(points), bool))
    d = dr.normalize(mi.Vector3f(1, 2, 3)) + dr.zeros(mi.Vector3f, len(points))
    return posed.evaluate(mi.Point3f(points.T), d, Located.anywhere(active), active)


def test_the_density_turns_and_moves_with_the_body(capture):
    volume, parameters = placed(capture)
    poses, row = capture.poses, 1
    turn = np.array([0.3, -0.5, 0.4])
    angle = np.linalg.norm(turn)
    rotation = mi.ScalarTransform4f().rotate((turn / angle).tolist(), np.rad2deg(angle))
    matrix = np.array(rotation.matrix)[:3, :3]
    rotations, vertices, shifts = (each.copy() for each in
                                   (poses.root_rotation, poses.vertices, poses.translation))
    rotations[row] = turn
    shifts[row] += 0.2
    vertices[row] = (poses.vertices[row] - poses.translation[row]) @ matrix.T + shifts[row]
    turned = dataclasses.replace(poses, root_rotation=rotations, vertices=vertices, translation=shifts)
    other, _ = placed(capture.with_body(capture.body, turned))
    frame, points = int(poses.frames[row]), around(poses.vertices[row])
    moved = (points - poses.translation[row]) @ matrix.T + shifts[row]
    before = evaluated(volume.at(frame, parameters), points)
    after = evaluated(other.at(frame, parameters), moved)
    # A vertex on the face between two voxels may fall to either side of it.
    close = np.isclose(after.sigma.numpy(), before.sigma.numpy(), rtol=1e-3)
    assert close.mean() > 0.97
    assert volume.at(frame, parameters).may_contain(mi.Point3f(points.T)).numpy().all()
    assert np.ptp(before.sigma.numpy()) > 0.1


def test_unseen_poses_have_the_latent_code_of_the_last_training_frame(capture):
    volume, parameters = placed(capture)
    first, last = capture.splits["train"].frames
    novel = capture.splits["novel_pose"].frames[0]
    points = {frame: around(capture.poses.vertices[capture.poses.index(frame)])
              for frame in (first, last, novel)}

    def colours(values):
        return {frame: evaluated(volume.at(frame, values), x).colour.numpy() for frame, x in points.items()}

    before = colours(parameters)
    latents = parameters["latents"].numpy().reshape(2, -1)
    for row, changed in ((0, {first}), (1, {last, novel})):
        other = latents.copy()
        other[row] += 1
        after = colours({**parameters, "latents": mi.Float(other.ravel())})
        assert {frame for frame in points if not np.allclose(after[frame], before[frame])} == changed


def test_density_is_that_of_evaluate_and_gradients_reach_all_parameters(capture):
    volume, parameters = placed(capture)
    points = around(capture.poses.vertices[0])
    frame = int(capture.poses.frames[0])
    active = mi.Bool(np.ones(len(points), bool))

    def total(values):
        sample = evaluated(volume.at(frame, values), points)
        return dr.mean(sample.sigma) + dr.mean(sample.colour.x * sample.colour.y)

    posed = volume.at(frame, parameters)
    np.testing.assert_allclose(
        posed.density(mi.Point3f(points.T), Located.anywhere(active), active),
        evaluated(posed, points).sigma, rtol=1e-5)
    attached = {name: mi.Float(value) for name, value in parameters.items()}
    dr.enable_grad(*attached.values())
    dr.backward(total(attached))
    for name, value in parameters.items():
        gradient = dr.grad(attached[name]).numpy().astype(float)
        # Along the gradient, where the change is largest compared with rounding.
        step = gradient / np.linalg.norm(gradient) * (3e-2 if name in ("codes", "latents") else 1e-3)
        slopes = [total({**parameters, name: mi.Float(value.numpy() + sign * step)})[0] for sign in (1, -1)]
        np.testing.assert_allclose(gradient @ step, (slopes[0] - slopes[1]) / 2, rtol=0.05)


def test_voxels_are_kept_within_a_bound(capture, monkeypatch):
    volume, _ = placed(capture)
    frames = [int(frame) for frame in capture.poses.frames]
    kept = [volume._placement(frame) for frame in frames]
    assert [volume._placement(frame) for frame in frames] == kept
    monkeypatch.setattr(volume_module, "CACHE_BYTES", kept[0].voxels.bytes + 1)
    again = placed(capture)[0]
    for frame in frames:
        again._placement(frame)
    assert list(again._kept) == frames[-1:]
