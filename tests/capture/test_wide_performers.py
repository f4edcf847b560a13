"""Coats, skirts, big hair, hats and bags: how far they stand off the body, that they stay outside it and in
the images; and that the standard performer does not change.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from winding import winding_number

from ndf_mi.body.anny import load_anny
from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems
from ndf_mi.capture.synthesise import plan
from ndf_mi.capture.synthesise.drape import Drape
from ndf_mi.capture.synthesise.layers import Layer
from ndf_mi.capture.synthesise.performer import Performer
from ndf_mi.capture.synthesise.plan import Look
from ndf_mi.capture.synthesise.synthesise import synthesise
from ndf_mi.errors import InputError

TINY = plan.SIZES["tiny"]
COUNTS = {"shirt": (20805, 40906), "trousers": (16093, 31592), "shoes": (6942, 13588),
          "skin": (32939, 65464), "hair": (7250, 14108), "eye": (1122, 2240)}
"""Vertices and triangles of the standard performer's layers."""

MEANS = {
    "shirt": (0.150295, 1.172310, 0.076896, 0.333461, 0.194809, 0.146709),
    "trousers": (0.123936, 0.520836, 0.064980, 0.096859, 0.134326, 0.239776),
    "shoes": (0.186016, 0.036413, 0.103237, 0.382807, 0.411434, 0.367396),
    "skin": (0.231820, 1.284501, 0.164055, 0.570387, 0.281970, 0.175726),
    "hair": (0.045776, 1.621685, 0.046155, 0.125321, 0.049889, 0.017169),
}
"""Means of |x|, |y|, |z| in metres, and of the linear colours, as before there were wide clothes."""

COAT, SKIRT = Look(clothes="coat", hair="hat", bag=True), Look(clothes="skirt", hair="big")


@pytest.fixture(scope="module")
def dressed() -> dict[str, Performer]:
    body = load_anny()
    looks = {"coat": COAT, "skirt": SKIRT}
    return {name: Performer(body, plan.shape_of(body), look) for name, look in looks.items()}


@pytest.fixture(scope="module")
def poses() -> Poses:
    return plan.motion(load_anny(), TINY)


def worn(performer: Performer, name: str) -> Layer:
    return next(layer for layer in performer.layers if layer.name == name)


def away(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Distances of points from the body's surface."""
    faces = load_anny().faces.astype(np.int64)
    squared = igl.point_mesh_squared_distance(points.astype(np.float64), vertices.astype(np.float64), faces)
    return np.sqrt(squared[0])


def at_rest(performer: Performer) -> np.ndarray:
    body = performer.body
    assert body.template is not None and body.shape_dirs is not None
    return np.asarray(body.template + body.shape_dirs @ performer.shape)


def posed(performer: Performer, poses: Poses, row: int) -> dict[str, np.ndarray]:
    vertices = performer.pose(poses.pose[row], poses.root_rotation[row], poses.translation[row],
                              poses.vertices[row])
    return {layer.name: moved for layer, moved in zip(performer.layers, vertices, strict=True)}


@pytest.mark.parametrize(("kind", "name"), [("coat", "coat tail"), ("skirt", "skirt")])
def test_hems_are_15_cm_from_the_standing_body(dressed: dict[str, Performer], kind: str, name: str) -> None:
    layer = worn(dressed[kind], name)
    assert layer.drape is not None
    hem = layer.rest[-len(layer.drape.phi) :]
    assert away(hem, at_rest(dressed[kind])).min() > 0.15
    assert (hem[:, 1] > 0.15).all() and (hem[:, 1] < 0.45).all()  # on the calves


def test_hair_hat_and_bag_stand_far_off(dressed: dict[str, Performer]) -> None:
    for kind, name, low, high in (("skirt", "hair", 0.15, 0.21), ("coat", "hat", 0.16, 0.24),
                                  ("coat", "bag", 0.2, 0.32)):
        distance = away(worn(dressed[kind], name).rest, at_rest(dressed[kind]))
        assert low < np.quantile(distance, 0.95) and distance.max() < high, name


@pytest.mark.long
@pytest.mark.parametrize(("kind", "name"), [("coat", "coat tail"), ("skirt", "skirt")])
def test_cloth_stays_outside_the_body_and_above_the_ground(
    dressed: dict[str, Performer], poses: Poses, kind: str, name: str
) -> None:
    some = np.random.default_rng(0).choice(len(worn(dressed[kind], name).rest), 60, replace=False)
    for row in (0, 2, 3):
        vertices = posed(dressed[kind], poses, row)[name]
        naked = trimesh.Trimesh(poses.vertices[row], load_anny().faces, process=False)
        inside = winding_number(vertices[some].astype(np.float64), naked.triangles) > 0.5
        assert inside.mean() <= 0.02 and vertices[:, 1].min() > 0
        assert np.median(away(vertices[-100:], poses.vertices[row])) > 0.12


def test_straps_lie_on_the_coat_and_follow_its_folds(dressed: dict[str, Performer], poses: Poses) -> None:
    layers = posed(dressed["coat"], poses, 2)
    faces = worn(dressed["coat"], "coat").faces.astype(np.int64)
    squared = igl.point_mesh_squared_distance(layers["straps"].astype(np.float64),
                                              layers["coat"].astype(np.float64), faces)[0]
    assert 0.004 < np.quantile(np.sqrt(squared), 0.05) and np.sqrt(squared).max() < 0.02


def hanging() -> tuple[Drape, np.ndarray, np.ndarray]:
    """A drape on a ring of 15 cm radius, 1 m above the ground, and joints that stay out of its way."""
    names = tuple(side + part for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Foot", "ToeBase"))
    phi = np.arange(72) / 72 * 2 * np.pi
    ring = 0.15 * np.stack([np.sin(phi), 0 * phi, np.cos(phi)], axis=1) + [0, 1, 0]
    return Drape(phi, np.linspace(0, 0.7, 60), 0.3, 0.02, names), ring, np.tile([0.0, 0.2, 0.0], (8, 1))


def legs(knee: float) -> np.ndarray:
    """Joints of two legs, the left thigh raised by `knee` radians."""
    left = np.array([0.1, 0.9, 0.0]) + [[0, 0, 0], [0, -0.4 * np.cos(knee), 0.4 * np.sin(knee)], [0, 0, 0],
                                        [0, 0, 0]]
    left[2:] = left[1] - [[0, 0.4, 0], [0, 0.42, -0.12]]
    right = np.array([[-0.1, 0.9, 0], [-0.1, 0.5, 0], [-0.1, 0.1, 0], [-0.1, 0.08, 0.12]])
    return np.concatenate([left, right])


def test_cloth_that_nothing_touches_hangs_in_its_flare_and_keeps_its_length() -> None:
    drape, ring, joints = hanging()
    cloth = drape(ring, joints).reshape(60, 72, 3)
    depth = 1 - cloth[..., 1]
    radius = np.linalg.norm(cloth[..., [0, 2]], axis=-1)
    np.testing.assert_allclose(radius, 0.15 + 0.3 * (depth / 0.7) ** 1.3, atol=2e-3)
    walked = np.linalg.norm(np.diff(cloth, axis=0), axis=-1).sum(axis=0)
    np.testing.assert_allclose(walked, 0.7, rtol=2e-3)


def test_cloth_hangs_from_a_raised_knee_and_is_smooth_in_the_pose() -> None:
    drape, ring, _ = hanging()
    low, high = (drape(ring, legs(angle)).reshape(60, 72, 3) for angle in (0.0, 1.2))
    assert high[-1, 2, 1] - low[-1, 2, 1] > 0.08  # the hem rises in front
    np.testing.assert_allclose(high[:, 36], low[:, 36], atol=0.01)  # and stays behind
    balls = legs(1.2)[1]
    assert np.linalg.norm(high - balls, axis=-1).min() > 0.07
    full, half = (drape(ring, legs(0.8 + step)) - drape(ring, legs(0.8)) for step in (1e-3, 5e-4))
    assert np.abs(full).max() < 5e-3 and np.abs(full - 2 * half).max() < 2e-5


def test_cloth_turns_with_the_hips() -> None:
    drape, ring, _ = hanging()
    turn = Rotation.from_rotvec([0, 0.7, 0])
    np.testing.assert_allclose(drape(turn.apply(ring), turn.apply(legs(0.9))),
                               turn.apply(drape(ring, legs(0.9))), atol=1e-9)


def test_the_standard_performer_is_unchanged() -> None:
    body = load_anny()
    layers = Performer(body, plan.shape_of(body)).layers
    assert {layer.name: (len(layer.rest), len(layer.faces)) for layer in layers} == COUNTS
    for layer in layers:
        if layer.name in MEANS:
            found = [*np.abs(layer.rest).mean(axis=0), *layer.colour.mean(axis=0)]
            np.testing.assert_allclose(found, MEANS[layer.name], atol=2e-6)
    assert Look().changes() == {} and not Look().wide
    hair = {clothes: Look(clothes=clothes).worn_hair for clothes in ("loose", "tight", "coat")}
    assert hair == {"loose": "bob", "tight": "none", "coat": "bob"}


def test_unknown_hair_and_clothes_name_the_option() -> None:
    with pytest.raises(InputError, match=r"--hair.*wig.*bob, big, hat, none"):
        Look(hair="wig")
    with pytest.raises(InputError, match=r"--clothes.*cape.*coat, skirt"):
        Look(clothes="cape")


@pytest.mark.long
def test_a_wide_performer_is_seen_whole_and_is_the_same_each_time(tmp_path: Path) -> None:
    settings = replace(TINY, pixels=32, spp=4, frames=2, view_frames=2, sequence_frames=0)
    first, second = (synthesise(tmp_path / name, settings, look=COAT) for name in "ab")
    assert problems(first) == [] and Capture.read(first).digest == Capture.read(second).digest
    made_with = json.loads((first / "synthesis.json").read_text())
    assert (made_with["clothes"], made_with["hair"], made_with["bag"]) == ("coat", "hat", True)
    capture = Capture.read(first)
    for pair in {pair for split in capture.splits.values() for pair in split}:
        mask = capture.mask(*pair)
        assert mask.any() and not (mask[0] | mask[-1]).any() and not (mask[:, 0] | mask[:, -1]).any()
    with pytest.raises(InputError, match="other settings"):
        synthesise(first, settings, look=replace(COAT, bag=False))
