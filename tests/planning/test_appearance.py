"""Estimates on synthetic observations: each effect is found at its size, and none where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from ndf_mi.planning.appearance import Appearance, directions
from ndf_mi.planning.observations import Observations, harmonics

FRAMES, CAMERAS, NOISE = 8, 6, 0.02


def ball(turning: bool) -> dict[str, np.ndarray]:
    """A grey ball of half a metre with noise in a ring of cameras, still or turning once around y."""
    random = np.random.default_rng(1)
    rest_normal = directions(1500)
    rows = []
    for frame in range(FRAMES):
        angle = 2 * np.pi * frame / FRAMES if turning else 0.0
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        for camera in range(CAMERAS):
            side = 2 * np.pi * camera / CAMERAS
            away = np.array([np.sin(side), 0.2, np.cos(side)]) / np.sqrt(1.04)
            normal = rest_normal @ turn.T
            at = np.flatnonzero(normal @ away > 0.35)
            rows.append({
                "place": at, "normal": normal[at], "to_camera": np.broadcast_to(away, (len(at), 3)),
                "to_camera_rest": np.broadcast_to(turn.T @ away, (len(at), 3)),
                "frame": np.full(len(at), frame), "camera": np.full(len(at), camera),
            })
    made = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    place = made.pop("place")
    usual = np.mean([harmonics(rest_normal @ np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0],
                                                       [-np.sin(a), 0, np.cos(a)]]).T)
                     for a in 2 * np.pi * np.arange(FRAMES) / FRAMES * turning], axis=0)
    count = len(place)
    texture = 0.5 + 0.1 * random.standard_normal(len(rest_normal))
    made |= {
        "rest": 0.5 * rest_normal[place], "rest_normal": rest_normal[place],
        "shading": harmonics(made["normal"]) - usual[place],
        "triangle": place, "uv": np.zeros((count, 2)), "footprint": np.full(count, 0.02),
        "colour": np.repeat(texture[place, None], 3, axis=1) + NOISE * random.standard_normal((count, 3)),
    }
    return made


def appearance(made: dict[str, np.ndarray], effect: np.ndarray | float = 0.0) -> Appearance:
    return Appearance(Observations(**(made | {"colour": made["colour"] + np.reshape(effect, (-1, 1))})))


@pytest.fixture(scope="module")
def turning() -> dict[str, np.ndarray]:
    return ball(True)


@pytest.fixture(scope="module")
def still() -> dict[str, np.ndarray]:
    return ball(False)


def test_where_nothing_changes_nothing_is_found(turning, still) -> None:
    for made in (turning, still):
        found = appearance(made)
        estimates = [found.normal(), found.view(False), *found.frame(False)]
        assert not any(estimate.significant for estimate in estimates)
        assert all(estimate.value < 0.1 * NOISE**2 for estimate in estimates)


def test_light_in_the_world_differs_from_light_that_turns_with_the_performer(turning) -> None:
    effect = 0.1 * turning["normal"][:, 0]
    found = appearance(turning, effect)
    # The difference of each pixel from the mean of its place in the other frames.
    place, frame = turning["triangle"], turning["frame"]
    total, count = np.bincount(place, effect), np.bincount(place)
    here = np.array([np.bincount(place, (frame == f) * x, minlength=len(total)) for f in range(FRAMES)
                     for x in (effect, 1.0)])
    others = count[place] - here[1::2][frame, place]
    alone = others > 0
    missed = effect[alone] - (total[place] - here[::2][frame, place])[alone] / others[alone]
    assert found.normal().significant and found.normal().value == pytest.approx(np.mean(missed**2), rel=0.25)
    assert not found.view(True).significant
    carried = appearance(turning, 0.1 * turning["rest_normal"][:, 0])
    assert not carried.normal().significant


def test_nothing_is_known_of_the_normal_if_the_performer_never_turns(still) -> None:
    assert not np.isfinite(appearance(still, 0.2 * still["normal"][:, 0]).normal().error)


def test_highlights_are_found_in_cameras_that_were_not_fitted(turning) -> None:
    n, w = turning["normal"], turning["to_camera"]
    mirrored = 2 * np.sum(n * w, axis=1, keepdims=True) * n - w
    lamp = np.array([0.6, 0.7, 0.4]) / np.linalg.norm([0.6, 0.7, 0.4])
    effect = 0.4 * np.exp(12 * (mirrored @ lamp - 1))
    found = appearance(turning, effect).view(True)
    assert found.significant and 0.3 * effect.var() < found.value < 1.1 * effect.var()


def test_changes_between_frames_are_found_at_their_size_and_separated_from_motion(still) -> None:
    random = np.random.default_rng(2)
    # One shift of brightness a frame, everywhere: nothing moves.
    shift = 0.05 * random.standard_normal(FRAMES)
    whole, within = appearance(still, shift[still["frame"]]).frame(False)
    assert whole.value == pytest.approx(shift.var(ddof=1), rel=0.1) and whole.value > 0
    assert not within.significant and abs(within.value) < 0.1 * whole.value
    # A fine texture that differs in each frame.
    texture = 0.05 * random.standard_normal((1500, FRAMES))
    whole, within = appearance(still, texture[still["triangle"], still["frame"]]).frame(False)
    assert whole.significant and within.significant and within.value > 0.7 * whole.value


def test_parallax_is_not_taken_for_change(still) -> None:
    """Colours that differ by place and camera, like a texture seen at another place from each side."""
    wrong = 0.1 * np.random.default_rng(3).standard_normal((1500, CAMERAS))
    found = appearance(still, wrong[still["triangle"], still["camera"]])
    assert not any(estimate.significant for estimate in (*found.frame(False), found.view(False)))
