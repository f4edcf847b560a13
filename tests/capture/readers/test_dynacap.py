"""DynaCap: the layout assumed is read, and so is one converted to ZJU-MoCap's; ten cameras train, five
test.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems
from ndf_mi.capture.readers.dynacap import read_dynacap
from ndf_mi.capture.readers.skeletool import read_calibrations
from ndf_mi.capture.readers.source import Selection
from ndf_mi.commands import main
from ndf_mi.errors import InputError


def calibration(cams: dict, side: int) -> str:
    """The file's text; the camera's name is its number."""
    lines = ["Skeletool Camera Calibration File V1.0"]
    for i, matrix in enumerate(cams["K"]):
        intrinsic, extrinsic = np.eye(4), np.eye(4)
        intrinsic[:3, :3] = matrix
        extrinsic[:3, :3], extrinsic[:3, 3:] = cams["R"][i], cams["T"][i]
        lines += ["", f"name          {i}", "  sensor      14 14", f"  size        {side} {side}",
                  "  animated    0"]
        for key, values in (("intrinsic", intrinsic), ("extrinsic", extrinsic)):
            lines.append(f"  {key}   " + " ".join(f"{value:.12g}" for value in values.ravel()))
        lines.append("  radial      0")
    return "\n".join(lines) + "\n"


@pytest.fixture
def raw(write_zju, tmp_path: Path) -> Path:
    """Fifteen cameras; fits of the frames 1 to 1,200, which but for two are copies; images of two frames from
    three cameras.
    """
    written = write_zju("converted", 15, range(1, 1201), (0, 1000), (0, 1, 2), undistorted=True)
    folder = tmp_path / "D1"
    shutil.copytree(written.folder / "new_params", folder / "new_params")
    for number in range(1, 1201):
        target = folder / f"new_params/{number}.npy"
        if not target.exists():
            target.symlink_to("1.npy")
    (folder / "cameras.calibration").write_text(calibration(written.cams, 96))
    for camera in (0, 1, 2):
        for number in (1, 1001):
            image = folder / f"images/{camera}/image_c_{camera}_f_{number}.jpg"
            mask = folder / f"foregroundSegmentation/{camera}/image_c_{camera}_f_{number}.jpg"
            for file in (image, mask):
                file.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(written.folder / f"Camera_B{camera + 1}/{number:06d}.jpg", image)
            label = (
                np.asarray(Image.open(written.folder / f"mask_cihp/Camera_B{camera + 1}/{number:06d}.png"))
                > 0
            )
            Image.fromarray(np.where(label, np.uint8(255), np.uint8(0))).save(mask, quality=80)
    return folder


SELECTION = Selection(frames=1000, test_frames=1000, train_cameras=("0", "2"), test_cameras=("1",))


def test_raw(raw: Path, smpl_file, tmp_path: Path, capsys) -> None:
    smpl, uv = smpl_file
    arguments = ["capture", "import", "dynacap", str(raw), "-o", str(tmp_path / "out"), "--smpl", str(smpl),
                 "--uv", str(uv)]
    arguments += ["--frames", "1000", "--test-frames", "1000", "--train-cameras", "0", "2", "--test-cameras",
                  "1"]
    assert main(arguments) == 0
    assert "dynacap-D1: 3 cameras of 48 x 48" in capsys.readouterr().out
    assert problems(tmp_path / "out") == []
    capture = Capture.read(tmp_path / "out")
    assert capture.splits["train"].frames == (1,) and capture.splits["novel_pose"].frames == (1001,)
    # Masks that JPEG has blurred are cut at the middle: the body's area is as OpenCV drew it, within its
    # outline.
    row = capture.poses.index(1)
    pixels = np.floor(capture.cameras["0"].project(capture.poses.vertices[row])).astype(int)
    assert capture.mask("0", 1)[pixels[:, 1].clip(0, 47), pixels[:, 0].clip(0, 47)].mean() > 0.85
    assert main([*arguments, "--subject", "313"]) == 2


def test_cameras_are_spread_evenly(raw: Path) -> None:
    source = read_dynacap(raw, Selection(frames=1, test_frames=30))
    assert source.splits["train"].cameras == tuple(str(i) for i in range(15) if i % 3 != 1)
    assert source.splits["novel_view"].cameras == ("1", "4", "7", "10", "13")
    assert source.splits["train"].frames == tuple(range(1, 1001)) and source.splits[
        "novel_pose"
    ].frames == tuple(range(1001, 1201, 30))


def test_fits_whose_names_have_leading_zeros(raw: Path) -> None:
    before = read_dynacap(raw, SELECTION)
    folder = raw / "new_params"
    for number in (1, *range(2, 1201)):
        (folder / f"{number}.npy").rename(folder / f"{number:06d}.npy")
    source = read_dynacap(raw, SELECTION)
    assert source.splits == before.splits
    assert source.fits == {frame: folder / f"{frame:06d}.npy" for frame in (1, 1001)}
    # Without zeros goes first, and what is not there goes by the name without.
    (folder / "1.npy").write_bytes((folder / "000001.npy").read_bytes())
    (folder / "001001.npy").unlink()
    (folder / "1001.npy").mkdir()
    assert read_dynacap(raw, SELECTION).fits == {1: folder / "1.npy", 1001: folder / "1001.npy"}


def test_converted(write_zju) -> None:
    """Fifty-one cameras, 2,100 frames: fifteen of those, 2,000 of these."""
    written = write_zju("D2", 51, range(2100))
    source = read_dynacap(written.folder)
    train, test = source.splits["train"], source.splits["novel_pose"]
    assert len(train.cameras) == 10 and len(test.cameras) == 5 and not set(train.cameras) & set(test.cameras)
    columns = sorted(int(name.removeprefix("Camera_B")) for name in (*train.cameras, *test.cameras))
    assert set(np.diff(columns)) <= {3, 4} and columns[0] == 1
    assert (train.frames[0], train.frames[-1], len(train.frames)) == (0, 999, 1000)
    assert test.frames == tuple(range(1000, 2000, 30))
    assert source.images["Camera_B1", 5][0] == written.folder / "Camera_B1/000005.jpg"


def test_calibrations(raw: Path) -> None:
    cameras = read_calibrations(raw / "cameras.calibration")
    assert list(cameras) == [str(i) for i in range(15)]
    first = cameras["0"]
    # The camera stands 3 m from (0.3, -0.2), at 1.5 m: x_camera = 0 there.
    np.testing.assert_allclose(first.rotation @ [3.3, -0.2, 1.5] + first.translation, 0, atol=1e-6)
    assert first.size == (96, 96)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("radial      0", "radial      1 0.1", "radial: found 1 0.1"),
    ("size        96 96", "size        96", "camera 0: size: found 96; expected 2 numbers"),
    ("name          3", "name          2", "a camera named '2'"),
    ("name ", "nom ", "no camera"),
    ("intrinsic", "intrinsics", "camera 0: intrinsic: found nothing"),
])  # fmt: skip
def test_bad_calibrations(raw: Path, old: str, new: str, words: str) -> None:
    file = raw / "cameras.calibration"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError, match=words) as raised:
        read_dynacap(raw, SELECTION)
    assert "cameras.calibration" in raised.value.where


def test_missing(raw: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: found no such folder"):
        read_dynacap(tmp_path / "nowhere")
    image = raw / "foregroundSegmentation/1/image_c_1_f_1001.jpg"
    image.unlink()
    with pytest.raises(InputError, match=r"image_c_1_f_1001.png: found no such file"):
        read_dynacap(raw, SELECTION).check_files()
    (raw / "cameras.calibration").rename(raw / "a.calibration")
    read_dynacap(raw, SELECTION)
    shutil.copy(raw / "a.calibration", raw / "b.calibration")
    with pytest.raises(InputError, match="a.calibration, b.calibration instead"):
        read_dynacap(raw, SELECTION)
    (raw / "b.calibration").unlink()
    shutil.rmtree(raw / "new_params")
    with pytest.raises(InputError, match="new_params: found no such folder"):
        read_dynacap(raw, SELECTION)
    (raw / "params").mkdir()
    with pytest.raises(InputError, match="0 frames with a fit; expected more than 1000"):
        read_dynacap(raw, SELECTION)
