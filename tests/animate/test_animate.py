"""Animation: the images are those of the run, shapes and poses reach the field, frames and video are what they say."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from skimage.io import imread, imsave

from ndf_mi import files
from ndf_mi.animate.animation import Animation, boxes
from ndf_mi.animate.frames import FrameFolder
from ndf_mi.animate.shape import parse_shape
from ndf_mi.animate.video import check_suffix, write_video
from ndf_mi.body.motion_file import read_performance
from ndf_mi.capture.viewpoint import framing
from ndf_mi.errors import InputError
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
        read_performance(tmp_path / name, model_run.body, model_run.poses) for name in ("rest.json", "turned.json")
    )
    held = dataclasses.replace(turned, stored=still.vertices(0)[None])
    images = [Animation(model_run, p, [view], samples=32).image(0) for p in (still, held)]
    assert np.abs(images[0] - images[1]).max() > 1e-4


def test_fingerprints_change_with_all_that_is_seen(model_run: Run, tmp_path: Path) -> None:
    frames = [{"time": t, "joints": {"middle": [0, 0, 400 * t]}} for t in (0, 0.1)]
    (tmp_path / "turn.json").write_text(json.dumps({"frames": frames}))
    view = camera(model_run)

    def prints(run: Run = model_run, cameras=(view,) * 4, shape=None, **how) -> list[str]:
        performance = read_performance(tmp_path / "turn.json", run.body, run.poses, shape=shape)
        animation = Animation(run, performance, cameras, **how)
        return [animation.fingerprint(frame) for frame in range(4)]

    first = prints()
    assert len(set(first)) == 4 and prints() == first
    others = [prints(cameras=(dataclasses.replace(view, fl_x=view.fl_x + 1),) * 4), prints(samples=64), prints(spp=2),
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
    assert sorted(p.name for p in place.iterdir()) == ["000000.png", "000001.png", "000002.png", "animation.json"]
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


@pytest.mark.parametrize("keep", [0, 4, 20, 0.5, 0.99, -13])
def test_a_frame_that_cannot_be_read_is_missing(tmp_path: Path, keep: float) -> None:
    folder = FrameFolder(tmp_path / "a", {})
    image = np.random.default_rng(0).random((40, 40, 3))
    for number in (0, 1):
        folder.write(number, image, "print")
    assert folder.has(0, "print") and folder.has(1, "print")
    whole = folder.frame(1).read_bytes()
    folder.frame(1).write_bytes(whole[: int(keep * len(whole)) if 0 < keep < 1 else int(keep)])
    assert folder.has(0, "print") and not folder.has(1, "print")
    folder.frame(1).write_bytes(whole[:200] + bytes(20) + whole[220:])
    assert not folder.has(1, "print")


def test_what_a_killed_write_left_is_no_other_file(tmp_path: Path) -> None:
    """Killed while the first animation.json is written: only what would be renamed to it is there."""
    place = tmp_path / "a"
    killed = "import os, pathlib\nfrom ndf_mi import files\n"
    killed += f"with files.replacing(pathlib.Path({str(place / 'animation.json')!r})) as beside:\n    os._exit(9)\n"
    assert subprocess.run([sys.executable, "-c", killed], check=False).returncode == 9
    (left,) = place.iterdir()
    assert left.suffix == ".json" and files.is_left_over(left) and not files.is_left_over(place / "animation.json")
    FrameFolder(place, {}).write(0, np.zeros((2, 2, 3)), "print")
    assert FrameFolder(place, {}).has(0, "print")


def test_frames_do_not_go_among_other_files(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("")
    with pytest.raises(InputError, match="other files and no animation.json"):
        FrameFolder(tmp_path, {})
    for text, message in (("{", "cannot be read"), ('{"format": "other"}', "something else")):
        (tmp_path / "animation.json").write_text(text)
        with pytest.raises(InputError, match=message):
            FrameFolder(tmp_path, {})


def test_boxes(model_run: Run) -> None:
    performance = read_performance(model_run.path / "poses.npz", model_run.body, model_run.poses)
    want = [[[-0.3 + 0.05 * i, -0.3, -0.3], [0.3 + 0.05 * i, 0.3, 0.3]] for i in range(3)]
    np.testing.assert_allclose(boxes(performance), want, atol=1e-3)


def test_shapes_as_written(model_run: Run, make_run) -> None:
    body = model_run.body
    own = np.array([0.5, 0.25], np.float32)
    assert parse_shape("tall=-0.5", body, own).tolist() == [0.5, -0.5]
    assert parse_shape(" tall = 1 , wide=2", body, None).tolist() == [2, 1]
    assert parse_shape("3", body, own).tolist() == [3, 0.25] and own.tolist() == [0.5, 0.25]
    for text, message in (("thin=1", "'thin'; expected one of wide, tall"), ("1,2,3", "3 coefficients; expected at most 2"),
                          ("tall=x", "'x' in 'tall=x'"), ("1,tall=2", "throughout"), ("nan", "finite"), ("", "finite")):  # fmt: skip
        with pytest.raises(InputError, match=message):
            parse_shape(text, body, own)
    with pytest.raises(InputError, match="--shape: found a run whose body has no skinning model"):
        parse_shape("1", make_run().body, None)


def test_video_reads_back(tmp_path: Path) -> None:
    """Five frames of one colour each, of odd sizes: as many come back, padded to even sizes, in their colours."""
    colours = [(200, 40, 40), (30, 160, 60), (40, 60, 210), (128, 128, 128), (240, 230, 90)]
    paths = []
    for i, colour in enumerate(colours):
        paths.append(tmp_path / f"{i}.png")
        imsave(paths[-1], np.full((45, 63, 3), colour, np.uint8), check_contrast=False)
    seen = []
    write_video(tmp_path / "v.mp4", paths, 12.5, lambda: seen.append(1))
    with imageio.get_reader(tmp_path / "v.mp4") as video:
        facts, back = video.get_meta_data(), [np.asarray(frame) for frame in video]
    assert len(back) == len(seen) == 5 and facts["size"] == (64, 46) and facts["fps"] == 12.5
    assert facts["codec"] == "h264" and facts["pix_fmt"].startswith("yuv420p")
    for frame, colour in zip(back, colours, strict=True):
        assert np.abs(frame.astype(int) - colour).max() <= 4
    with pytest.raises(InputError, match=".mp4"):
        check_suffix("v.avi")
    with pytest.raises(FileNotFoundError):
        write_video(tmp_path / "w.mp4", [tmp_path / "none.png"], 10)
    assert not list(tmp_path.glob("*w*.mp4"))


def test_the_description_tells_what_was_asked(tmp_path: Path) -> None:
    folder = FrameFolder(tmp_path / "a", {"motion": "walk"})
    folder.write(7, np.zeros((2, 2, 3)), "abc")
    found = json.loads((tmp_path / "a" / "animation.json").read_text())
    assert found["asked"] == {"motion": "walk"} and found["frames"] == {"000007": "abc"}
