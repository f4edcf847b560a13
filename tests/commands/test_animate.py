"""`ndf-mi animate`: frames and video, continuing after an interruption, and invalid input."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from skimage.io import imread

from ndf_mi.animate import video
from ndf_mi.commands import main
from ndf_mi.render.image import ImageRenderer

SMALL = ["--size", "24", "20", "--samples", "8"]


def times(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("*.png")}


def test_frames_and_video_are_written_and_reused(make_constant_run, tmp_path, capsys):
    run = make_constant_run(200.0, srgb=(0.8, 0.4, 0.2))
    out, folder = tmp_path / "out" / "a.mp4", tmp_path / "out" / "a.frames"
    command = ["animate", str(run.path), "--motion", str(run.path / "poses.npz"), "-o", str(out), *SMALL]
    assert main(command) == 0
    assert "3 frames" in capsys.readouterr().out
    with imageio.get_reader(out) as reader:
        facts, back = reader.get_meta_data(), [np.asarray(frame) for frame in reader]
    assert len(back) == 3 and facts["size"] == (24, 20) and facts["fps"] == 30
    frames = [imread(folder / f"{i:06d}.png") for i in range(3)]
    assert all(np.abs(frame[10, 12].astype(int) - [204, 102, 51]).max() <= 2 and (frame[0, 0] == 0).all()
               for frame in frames)
    assert all(np.abs(a.astype(int) - b).mean() < 6 for a, b in zip(back, frames, strict=True))

    before = times(folder)
    (folder / "000001.png").unlink()
    out.unlink()
    assert main(command) == 0 and out.is_file()
    after = times(folder)
    assert [name for name in after if after[name] != before[name]] == ["000001.png"]
    assert np.array_equal(imread(folder / "000001.png"), frames[1])

    assert main([*command, "--frames", "::2", "--background", "1", "1", "1"]) == 0
    with imageio.get_reader(out) as reader:
        assert reader.get_meta_data()["fps"] == 15 and len([*map(np.shape, reader)]) == 2
    corners = [imread(folder / f"{i:06d}.png")[0, 0] for i in (1, 2)]
    assert (corners[0] == 0).all() and (corners[1] == 255).all()
    asked = json.loads((folder / "animation.json").read_text())["asked"]
    assert asked["background"] == [1, 1, 1] and asked["frames"] == "::2"


def test_interrupted_while_rendering_and_while_encoding(make_run, tmp_path, monkeypatch, capsys):
    run = make_run()
    out = tmp_path / "a.mp4"
    command = ["animate", str(run.path), "--motion", str(run.path / "poses.npz"), "-o", str(out), *SMALL]
    render, seen = ImageRenderer.__call__, []

    def stops(self, *arguments, **options):
        seen.append(1)
        if len(seen) == 3:
            raise KeyboardInterrupt
        return render(self, *arguments, **options)

    monkeypatch.setattr(ImageRenderer, "__call__", stops)
    assert main(command) == 130
    assert "2 of 3 frames" in capsys.readouterr().out
    assert len(times(tmp_path / "a.frames")) == 2 and not out.exists()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(video, "write_video", interrupted)
    assert main(command) == 130 and len(seen) == 4
    assert "3 of 3 frames" in capsys.readouterr().out
    monkeypatch.undo()
    assert main(command) == 0 and len(seen) == 4 and out.is_file()
    assert {path.name for path in tmp_path.iterdir()} == {"run", "a.frames", "a.mp4"}


@pytest.mark.parametrize(("arguments", "words"), [
    (["-o", "x.avi"], ".mp4"),
    (["--motion", "swim"], "one of the clips"),
    (["--motion", "walk"], "no skinning model"),
    (["--motion", "nan.npz"], "nan at frame 1, joint 1"),
    (["--motion", "empty.npz"], "at least one"),
    (["--motion", "bad.json"], "cannot be read as JSON"),
    (["--motion", "deep.json"], "nested too deep"),
    (["--motion", "deep.bvh"], "no skinning model"),
    (["--camera", "huge.json"], "frames[0].w: found 1000"),
    (["--camera", "nowhere"], "orbit, CAPTURE:NAME"),
    (["--camera", "nowhere", "--turns", "2"], "--turns"),
    (["--shape", "1"], "no skinning model"),
    (["--frames", "5:"], "0 to 2"),
    (["--frames", "a:b"], "FIRST:END"),
    (["--frames", "0:3:0"], "a step above 0"),
    (["--fps", "0"], "--fps"),
    (["--fps", "1000"], "a video of 0.1 to 240"),
    (["--size", "0", "4"], "--size"),
    (["--samples", "0"], "--samples"),
    (["--spp", "0"], "--spp"),
    (["--background", "2", "0", "0"], "--background"),
    (["--elevation", "90"], "--elevation"),
    (["--azimuth", "inf"], "--azimuth"),
    (["--up", "y"], "AMASS-like"),
    (["-o", "RUN/config.json/x.mp4"], "cannot be written"),
])  # fmt: skip
def test_invalid_input_exits_with_code_2(make_run, tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    run = make_run("RUN")
    entries = dict(np.load(run.path / "poses.npz"))
    np.savez("empty.npz", **{key: value[:0] for key, value in entries.items()})
    entries["pose"][1, 1, 2] = np.nan
    np.savez("nan.npz", **entries)
    (tmp_path / "bad.json").write_text("{")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "huge.json").write_text(json.dumps({"frames": [{"w": 10**400}]}))
    joints = "".join(f"{'JOINT' if i else 'ROOT'} j{i}\n{{\nOFFSET 0 1 0\n" for i in range(3000))
    closed = "CHANNELS 1 Xrotation\n" + "}\n" * 3000
    (tmp_path / "deep.bvh").write_text(f"HIERARCHY\n{joints}{closed}MOTION\nFrames: 1\nFrame Time: 1\n0\n")
    before = set(tmp_path.rglob("*"))
    given = {"--motion": ["RUN/poses.npz"], "-o": ["x.mp4"]}
    given[arguments[0]] = arguments[1:]
    assert main(["animate", "RUN", *SMALL[3:],
                 *(word for key, values in given.items() for word in (key, *values))]) == 2
    error = capsys.readouterr().err
    assert words in error and "Traceback" not in error
    assert set(tmp_path.rglob("*")) == before
