"""The synthetic capture: valid on disk, the same for the same seed, resumable, with clothes that answer to
the pose.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import drjit as dr
import igl
import mitsuba as mi
import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from winding import winding_number

from ndf_mi.body.anny import load_anny
from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems
from ndf_mi.capture.synthesise import plan
from ndf_mi.capture.synthesise.performer import Performer
from ndf_mi.capture.synthesise.plan import Look
from ndf_mi.capture.synthesise.ring import camera_ring
from ndf_mi.capture.synthesise.studio import Studio
from ndf_mi.capture.synthesise.synthesise import synthesise
from ndf_mi.errors import InputError
from ndf_mi.mitsuba_mesh import make_mesh

TINY = plan.SIZES["tiny"]


@pytest.fixture(scope="module")
def performer() -> Performer:
    body = load_anny()
    return Performer(body, plan.shape_of(body))


@pytest.fixture(scope="module")
def poses() -> Poses:
    return plan.motion(load_anny(), TINY)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthesise(tmp_path_factory.mktemp("synthesise") / "tiny", TINY)


def posed(performer: Performer, poses: Poses, row: int) -> list[np.ndarray]:
    return performer.pose(poses.pose[row], poses.root_rotation[row], poses.translation[row],
                          poses.vertices[row])


def silhouette(capture: Capture, camera: str, frame: int) -> np.ndarray:
    """Pixels wholly covered by the naked body, ray traced by Mitsuba."""
    vertices = capture.poses.vertices[capture.poses.index(frame)]
    mesh = make_mesh("naked", vertices, capture.body.faces)
    sensor = capture.cameras[camera].sensor(spp=16)
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "direct"}, "sensor": sensor, "mesh": mesh})
    return np.array(mi.render(scene))[..., 3] > 0.99


def test_the_capture_is_sound_and_holds_the_images_of_its_splits_alone(tiny: Path) -> None:
    assert problems(tiny) == []
    capture = Capture.read(tiny)
    named = {pair for split in capture.splits.values() for pair in split}
    assert len(list((tiny / "images").rglob("*.png"))) == len(named)
    train, view, pose = (capture.splits[name] for name in ("train", "novel_view", "novel_pose"))
    assert len(train.cameras) == 2 and len(view.cameras) == 3
    assert not set(train.cameras) & (set(view.cameras) | set(pose.cameras))
    assert set(view.frames) <= set(train.frames) and not set(pose.frames) & set(train.frames)
    sequence = capture.splits["sequence"]
    assert (
        len(sequence.cameras) == 1
        and set(sequence.cameras) <= set(pose.cameras)
        and len(sequence.frames) == 2
    )
    assert not set(sequence.frames) & (set(train.frames) | set(pose.frames))
    # Successive frames at 30 Hz: centimetres from one to the next, where other frames are decimetres apart.
    first, second = (capture.poses.vertices[capture.poses.index(frame)] for frame in sequence.frames)
    assert 0.005 < np.linalg.norm(second - first, axis=-1).mean() < 0.05
    scene = mi.load_file(str(tiny / "lighting.xml"))
    assert len(scene.emitters()) == 1


def test_masks_contain_the_naked_body_and_images_show_a_performer_that_fills_them(tiny: Path) -> None:
    capture = Capture.read(tiny)
    for camera, frame in (("cam00", 0), ("cam01", 1), ("cam04", 3)):
        mask, image = capture.mask(camera, frame), capture.image(camera, frame)
        naked = silhouette(capture, camera, frame)
        assert (mask & naked).sum() >= 0.98 * naked.sum()
        assert mask.sum() > 1.1 * naked.sum()
        rows = np.flatnonzero(mask.any(axis=1))
        assert 0.6 < (rows[-1] - rows[0] + 1) / len(mask) < 0.97
        assert not (mask[0] | mask[-1]).any() and not (mask[:, 0] | mask[:, -1]).any()
        inner = binary_erosion(mask, iterations=2)
        assert image[inner].std() > 0.1
        np.testing.assert_allclose(image[~mask], 0.5, atol=1 / 255)


def test_the_same_seed_makes_the_same_capture_and_a_stopped_one_goes_on(tiny: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(tiny, again)
    (again / "capture.json").unlink()
    (again / ".lighting-ab12cd_9.exr").write_bytes(b"")  # as a killed process leaves it
    lost = again / "images" / "cam00" / "000001.png"
    kept = again / "images" / "cam01" / "000001.png"
    lost.unlink()
    stamp = kept.stat().st_mtime_ns
    calls: list[tuple[int, int]] = []
    synthesise(again, TINY, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(12, 13), (13, 13)]
    assert kept.stat().st_mtime_ns == stamp
    assert lost.read_bytes() == (tiny / "images" / "cam00" / "000001.png").read_bytes()
    assert Capture.read(again).digest == Capture.read(tiny).digest


def test_what_is_there_is_not_overwritten_unasked(tiny: Path, tmp_path: Path) -> None:
    digest = Capture.read(tiny).digest
    synthesise(tiny, TINY)
    with pytest.raises(InputError, match="a capture made with other settings"):
        synthesise(tiny, replace(TINY, seed=5))
    assert Capture.read(tiny).digest == digest
    (tmp_path / "letters.txt").write_text("dear")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"letters.txt.*new or empty"):
            synthesise(tmp_path, TINY, overwrite=overwrite)
    with pytest.raises(InputError, match="a file; expected a folder"):
        synthesise(tmp_path / "letters.txt", TINY)


def test_overwrite_replaces_a_capture_and_leaves_nothing_of_it(tiny: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(tiny, other)
    (other / "images" / "cam00" / "000099.png").write_bytes(b"")
    small = replace(TINY, frames=1, view_frames=1, pose_frames=0, cameras=2, train_cameras=1, pose_cameras=1,
                    sequence_frames=0, seed=3)
    synthesise(other, small, overwrite=True)
    assert problems(other) == []
    assert len(list((other / "images").rglob("*.png"))) == 2
    assert json.loads((other / "synthesis.json").read_text())["seed"] == 3


@pytest.mark.long
def test_another_light_changes_the_images_and_nothing_else(tiny: Path, tmp_path: Path) -> None:
    other = synthesise(tmp_path / "evening", TINY, light="evening")
    assert problems(other) == []
    for file in ("poses.npz", "body.npz", "capture.json"):
        assert (other / file).read_bytes() == (tiny / file).read_bytes()
    names = [file.relative_to(tiny) for file in (tiny / "masks").rglob("*.png")]
    assert names and all((other / name).read_bytes() == (tiny / name).read_bytes() for name in names)
    here, there = (Capture.read(path).image("cam00", 0) for path in (tiny, other))
    mask = Capture.read(tiny).mask("cam00", 0)
    assert np.abs(here - there)[binary_erosion(mask)].mean() > 0.1
    # Captures from before there was a choice are known again.
    assert "light" not in json.loads((tiny / "synthesis.json").read_text())
    with pytest.raises(InputError, match="other settings"):
        synthesise(other, TINY)
    with pytest.raises(InputError, match="--light.*noon.*evening"):
        synthesise(tmp_path / "noon", TINY, light="noon")
    assert not (tmp_path / "noon").exists()


@pytest.mark.parametrize("change",
                         [{"pixels": 4}, {"cameras": 0}, {"view_frames": 99}, {"frames": 0}, {"spp": 0}])
def test_impossible_settings_name_the_option(change: dict[str, int]) -> None:
    with pytest.raises(InputError, match=f"--{next(iter(change)).replace('_', '-')}|--train-cameras"):
        replace(TINY, **change)


@pytest.mark.long
def test_clothes_stand_off_the_body_and_stay_out_of_it(performer: Performer, poses: Poses) -> None:
    naked = trimesh.Trimesh(poses.vertices[1], performer.body.faces, process=False)
    surface = cKDTree(trimesh.sample.sample_surface(naked, 100_000, seed=0)[0])
    random = np.random.default_rng(0)
    farthest = 0.0
    for layer, vertices in zip(performer.layers, posed(performer, poses, 1), strict=True):
        if layer.name in ("shirt", "trousers"):
            distance, _ = surface.query(vertices)
            assert np.median(distance) > 0.015
            assert distance.max() < 0.08
            farthest = max(farthest, distance.max())
            some = random.choice(len(vertices), 40, replace=False)
            assert (winding_number(vertices[some].astype(np.float64), naked.triangles) > 0.5).mean() <= 0.01
    assert farthest > 0.04


def test_wrinkles_follow_the_pose(performer: Performer) -> None:
    """The same point of cloth is displaced otherwise when its joint bends, and not when a far one does."""
    assert performer.body.joint_names is not None
    shirt = next(layer for layer in performer.layers if layer.name == "shirt")
    assert shirt.folds is not None
    straight = {name: np.zeros(3) for name in performer.body.joint_names}
    rest = shirt.folds.displacement(straight)
    bent = shirt.folds.displacement({**straight, "LeftForeArm": np.array([0.0, 1.2, 0.0])})
    head = shirt.folds.displacement({**straight, "Head": np.array([0.5, 0.0, 0.0])})
    np.testing.assert_array_equal(head, rest)
    moved = np.abs(bent - rest)
    assert moved.max() > 0.004
    left, right = shirt.rest[:, 0] > 0.25, shirt.rest[:, 0] < -0.05
    assert moved[left].max() == moved.max() and moved[right].max() < 1e-6


def test_wrinkles_are_smooth_in_the_pose(performer: Performer) -> None:
    """Halving a step of the pose halves the change, at the pose of rest too."""
    shirt = next(layer for layer in performer.layers if layer.name == "shirt")
    assert shirt.folds is not None and performer.body.joint_names is not None
    direction = np.random.default_rng(0).normal(size=(len(performer.body.joint_names), 3)) * 0.3

    def at(t: float) -> np.ndarray:
        assert shirt.folds is not None and performer.body.joint_names is not None
        return shirt.folds.displacement(dict(zip(performer.body.joint_names, direction * t, strict=True)))

    for t in (0.0, 0.7):
        full, half = at(t + 1e-3) - at(t), at(t + 5e-4) - at(t)
        assert np.abs(full - 2 * half).max() < 1e-5


@pytest.mark.long
def test_one_kernel_renders_every_camera_and_frame(performer: Performer, poses: Poses) -> None:
    cameras = list(camera_ring(3, 40, poses.vertices, 0).values())
    studio = Studio(performer.layers, 9)
    studio.pose(posed(performer, poses, 0))
    studio.render(cameras[0], 0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for row, camera in ((0, cameras[1]), (2, cameras[2])):
            studio.pose(posed(performer, poses, row))
            studio.render(camera, 7)
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert kernels and sum(not kernel["cache_hit"] for kernel in kernels) == 0


def test_pixels_left_out_are_those_that_the_performer_does_not_touch(
    performer: Performer, poses: Poses
) -> None:
    """Mitsuba's own render of the whole image agrees in coverage and in mean colour."""
    camera = camera_ring(1, 64, poses.vertices, 0)["cam00"]
    studio = Studio(performer.layers, 256)
    studio.pose(posed(performer, poses, 0))
    radiance, coverage = studio.render(camera, 1)
    sensor = mi.load_dict(camera.sensor(spp=256, sampler="multijitter"))
    whole = np.array(mi.render(studio.scene, sensor=sensor, integrator=studio.integrator, seed=2))
    assert np.abs(coverage - whole[..., 3]).max() < 0.15
    assert not (whole[..., 3][coverage == 0] > 0.02).any()
    np.testing.assert_allclose(radiance.mean(axis=(0, 1)), whole[..., :3].mean(axis=(0, 1)), rtol=0.01)


@pytest.mark.parametrize("kind", ["turn", "still"])
def test_one_pose_is_held_while_the_performer_turns_or_stands(kind: str) -> None:
    poses = plan.motion(load_anny(), replace(TINY, frames=4), kind)
    assert len(poses) == 7 and np.ptp(poses.pose[:4], axis=0).max() == 0
    angles = np.arange(4) * np.pi / 2 * (kind == "turn")
    for row, angle in enumerate(angles):
        turn = Rotation.from_rotvec([0, angle, 0])
        np.testing.assert_allclose(poses.vertices[row], turn.apply(poses.vertices[0]), atol=1e-5)
        # Poses.vertices are R X + t, of one X here.
        back = (
            Rotation.from_rotvec(poses.root_rotation[row])
            .inv()
            .apply(poses.vertices[row] - poses.translation[row])
        )
        first = (
            Rotation.from_rotvec(poses.root_rotation[0]).inv().apply(poses.vertices[0] - poses.translation[0])
        )
        np.testing.assert_allclose(back, first, atol=1e-5)
        gone = plan.heading(poses.root_rotation[row]) - plan.heading(poses.root_rotation[0]) - angle
        assert np.cos(gone) == pytest.approx(1, abs=1e-6)
    # The novel poses do not change.
    assert np.ptp(poses.pose[3:5], axis=0).max() > 0.1


@pytest.mark.long
def test_tight_clothes_lie_on_the_body_and_do_not_fold_when_told_not_to(poses: Poses) -> None:
    body = load_anny()
    naked, faces = poses.vertices[0].astype(np.float64), body.faces.astype(np.int64)
    distances = {}
    for clothes in ("loose", "tight"):
        dressed = Performer(body, plan.shape_of(body), Look(clothes=clothes, folds=False))
        assert all(layer.folds is None for layer in dressed.layers)
        assert ("hair" in {layer.name for layer in dressed.layers}) == (clothes == "loose")
        layers = zip(dressed.layers, posed(dressed, poses, 0), strict=True)
        worn = [vertices for layer, vertices in layers if layer.name in ("shirt", "trousers")]
        squared = igl.point_mesh_squared_distance(np.concatenate(worn).astype(np.float64), naked, faces)[0]
        distances[clothes] = np.sqrt(squared)
    assert np.quantile(distances["tight"], 0.95) < 0.0125 and np.median(distances["loose"]) > 0.015


@pytest.mark.long
def test_choices_are_recorded_and_flat_light_shows_reflectance(tiny: Path, tmp_path: Path) -> None:
    one = replace(TINY, frames=2, view_frames=0, pose_frames=0, sequence_frames=0)
    look = Look("turn", "tight", False, "matte")
    flat = synthesise(tmp_path / "flat", one, light="flat", look=look)
    assert problems(flat) == []
    assert Capture.read(flat).lighting is None and not (flat / "lighting.xml").exists()
    made_with = json.loads((flat / "synthesis.json").read_text())
    assert {key: made_with[key] for key in ("motion", "clothes", "folds", "surface", "light")} == {
        "motion": "turn", "clothes": "tight", "folds": False, "surface": "matte", "light": "flat"}
    assert "motion" not in json.loads((tiny / "synthesis.json").read_text())
    with pytest.raises(InputError, match="other settings"):
        synthesise(flat, one, light="flat", look=replace(look, surface="glossy"))
    with pytest.raises(InputError, match="--clothes.*none.*tight"):
        Look(clothes="none")
    # Skin's reflectance is (206, 152, 122) in sRGB, mottled by a few percent: the brightest of the head is
    # near it, in any frame.
    for frame in (0, 1):
        image, mask = Capture.read(flat).image("cam00", frame), Capture.read(flat).mask("cam00", frame)
        top = np.flatnonzero(mask.any(axis=1))[0] + 2
        head = image[top : top + 2][binary_erosion(mask)[top : top + 2]]
        assert len(head) and np.abs(np.median(head, axis=0) - np.array([206, 152, 122]) / 255).max() < 0.06


@pytest.mark.long
def test_carried_light_turns_with_the_performer(tmp_path: Path) -> None:
    """A quarter of a turn on, a camera that turned along sees the same picture under carried light, and
    another under the studio's.
    """
    settings = replace(TINY, pixels=32, spp=256, cameras=4, train_cameras=4, frames=4, view_frames=0,
                       pose_frames=0, pose_cameras=1,
                       sequence_frames=0)
    body = load_anny()
    poses = plan.motion(body, settings, "turn")
    performer = Performer(body, plan.shape_of(body), Look("turn", "tight", False, "matte"))
    camera = camera_ring(4, 32, poses.vertices, 0)["cam00"]
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()
    cameras = [camera, replace(camera, transform=quarter @ camera.transform)]
    difference = {}
    for light in ("carried", "studio"):
        studio = Studio(performer.layers, 256, light)
        images = []
        for row in (0, 1):
            studio.pose(posed(performer, poses, row), plan.heading(poses.root_rotation[row]))
            images.append(studio.render(cameras[row], 3)[0])
        difference[light] = np.abs(images[0] - images[1]).mean()
    assert difference["carried"] < 0.2 * difference["studio"]
