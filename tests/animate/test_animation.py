"""Animations: images equal those of the run, and poses and shapes reach the field."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from skimage.io import imread

from ndf_mi.animate.animation import Animation, boxes
from ndf_mi.animate.frames import FrameFolder
from ndf_mi.animate.shape import parse_shape
from ndf_mi.body.motion_file import read_performance
from ndf_mi.capture.camera import framing
from ndf_mi.render.image import ImageRenderer
from ndf_mi.run import Run


def camera(run: Run, size: int = 24):
    return framing(run.poses.vertices[0], size, size, azimuth=20)


@pytest.mark.parametrize("model", [True, False])
def test_the_runs_own_poses_give_the_runs_own_images(make_run, model_run: Run, model: bool) -> None:
    run = model_run if model else make_run()
    performance = read_performance(run.path / "poses.npz", run.body, run.poses)
    view = camera(run)
    animation = Animation(run, performance, [view] * 3, samples=16)
    for frame in (0, 2):
        want = ImageRenderer(16)(run.posed(frame), view).over(run.background)
        assert np.array_equal(animation.image(frame), want)
    assert np.ptp(want) > 0


def test_pose_and_shape_reach_the_image(model_run: Run, tmp_path: Path) -> None:
    """A ball of twice the width is seen twice as wide; a pose that moves no vertex changes the colours."""
    (tmp_path / "rest.json").write_text('{"frames": [{"time": 0}]}')
    (tmp_path / "turned.json").write_text('{"frames": [{"time": 0, "joints": {"middle": [0, 0, 40]}}]}')
    view = framing(2 * model_run.poses.vertices[0], 48, 48)
    widths = []
    for shape in (None, parse_shape("wide=1", model_run.body, model_run.poses.shape)):
        performance = read_performance(tmp_path / "rest.json", model_run.body, model_run.poses, shape=shape)
        image = Animation(model_run, performance, [view], samples=32).image(0)
        widths.append(np.count_nonzero(np.abs(image - model_run.background).max(-1).max(0) > 0.02))
    # The band stands 8 cm off the ball of 30 cm: 0.76 and 1.36 m.
    assert widths[1] / widths[0] == pytest.approx(1.36 / 0.76, abs=0.15)
    still, turned = (
        read_performance(tmp_path / name, model_run.body, model_run.poses)
        for name in ("rest.json", "turned.json")
    )
    held = dataclasses.replace(turned, stored=still.vertices(0)[None])
    images = [Animation(model_run, p, [view], samples=32).image(0) for p in (still, held)]
    assert np.abs(images[0] - images[1]).max() > 1e-4


def test_cache_keys_change_with_everything_that_changes_an_image(model_run: Run, tmp_path: Path) -> None:
    frames = [{"time": t, "joints": {"middle": [0, 0, 400 * t]}} for t in (0, 0.1)]
    (tmp_path / "turn.json").write_text(json.dumps({"frames": frames}))
    view = camera(model_run)

    def prints(run: Run = model_run, cameras=(view,) * 4, shape=None, **how) -> list[str]:
        performance = read_performance(tmp_path / "turn.json", run.body, run.poses, shape=shape)
        animation = Animation(run, performance, cameras, **how)
        return [animation.cache_key(frame) for frame in range(4)]

    first = prints()
    assert len(set(first)) == 4 and prints() == first
    others = [prints(cameras=(dataclasses.replace(view, fl_x=view.fl_x + 1),) * 4), prints(samples=64),
              prints(spp=2),
              prints(background=[0, 0, 0]), prints(shape=np.array([0, 0.1], np.float32))]  # fmt: skip
    model_run.parameters = model_run.parameters.replace(weights=model_run.parameters.weights + 1e-3)
    others.append(prints())
    for other in others:
        assert not set(other) & set(first)


def test_only_what_is_missing_is_rendered(model_run: Run, tmp_path: Path) -> None:
    performance = read_performance(model_run.path / "poses.npz", model_run.body, model_run.poses)
    animation = Animation(model_run, performance, [camera(model_run)] * 3, samples=8)
    place = tmp_path / "a.frames"
    assert list(animation.missing(FrameFolder(place, {}), range(3))) == [0, 1, 2] and not place.exists()
    folder = FrameFolder(place, {"motion": "poses.npz"})
    animation.write(folder, animation.missing(folder, range(3)))
    assert sorted(p.name for p in place.iterdir()) == ["000000.png", "000001.png", "000002.png",
                                                       "animation.json"]
    shown = np.round(animation.image(1) * 255).astype(np.uint8)
    assert np.array_equal(imread(place / "000001.png"), shown)
    (place / "000001.png").unlink()
    assert list(animation.missing(FrameFolder(place, {}), range(3))) == [1]
    other = Animation(model_run, performance, [camera(model_run)] * 3, samples=9)
    assert list(other.missing(FrameFolder(place, {}), range(3))) == [0, 1, 2]


def test_a_stopped_job_keeps_its_frames(model_run: Run, tmp_path: Path) -> None:
    performance = read_performance(model_run.path / "poses.npz", model_run.body, model_run.poses)
    animation = Animation(model_run, performance, [camera(model_run)] * 3, samples=8)
    folder = FrameFolder(tmp_path / "a.frames", {})

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        animation.write(folder, animation.missing(folder, [0, 1, 2]), stop)
    assert list(animation.missing(FrameFolder(tmp_path / "a.frames", {}), [0, 1, 2])) == [1, 2]


def test_boxes(model_run: Run) -> None:
    performance = read_performance(model_run.path / "poses.npz", model_run.body, model_run.poses)
    want = [[[-0.3 + 0.05 * i, -0.3, -0.3], [0.3 + 0.05 * i, 0.3, 0.3]] for i in range(3)]
    np.testing.assert_allclose(boxes(performance), want, atol=1e-3)
