"""The BVH reader on a two-bone arm worked out by hand, and on files that are wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ndf_mi.body.bvh import Clip, read_bvh
from ndf_mi.errors import InputError

ARM = """HIERARCHY
ROOT Upper
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Fore
  {
    OFFSET 4 0 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 3 0 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.5
0 0 0 0 0 0 0 0 0
10 0 0 0 0 0 90 0 0
0 0 0 90 0 90 90 0 0
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.bvh"
    path.write_text(text)
    return path


def tips(clip: Clip) -> np.ndarray:
    """(T, 3): the end site below the forearm."""
    rotations, positions = clip.forward()
    return positions[:, 1] + rotations[:, 1] @ [3, 0, 0]


def test_arm(tmp_path: Path) -> None:
    clip = read_bvh(write(tmp_path, ARM))
    assert clip.joint_names == ("Upper", "Fore") and clip.parents.tolist() == [-1, 0]
    assert len(clip) == 3 and clip.duration == 1.0 and clip.name == "arm"
    np.testing.assert_allclose(clip.offsets, [[1, 2, 3], [4, 0, 0]])
    _, positions = clip.forward()
    np.testing.assert_allclose(positions[:, 1], [[4, 0, 0], [14, 0, 0], [0, 4, 0]], atol=1e-12)
    # Last frame: the upper arm is turned by Rz(90)·Rx(90), the elbow by Rz(90) inside it: x → y → Rz(90)·z =
    # z.
    np.testing.assert_allclose(tips(clip), [[7, 0, 0], [14, 3, 0], [0, 4, 3]], atol=1e-12)


def with_positions_at_zero(text: str) -> str:
    """The arm with position channels for the forearm, all zero."""
    text = text.replace("CHANNELS 3 Z", "CHANNELS 6 Xposition Yposition Zposition Z")
    head, time, frames = text.partition("Frame Time: 0.5\n")
    rows = [line.split() for line in frames.splitlines()]
    return head + time + "".join(" ".join([*row[:6], "0 0 0", *row[6:]]) + "\n" for row in rows)


@pytest.mark.parametrize("change", [
    lambda text: "\ufeff" + text,
    lambda text: re.sub(r"(ROOT|JOINT) (\w+)\n\s*{", r"\1 \2 {", text),
    lambda text: with_positions_at_zero(text),
    lambda text: text.replace("\n", "\r\n\r\n"),
], ids=["byte order mark", "brace on the line of the name", "position channels at zero", "CRLF"])  # fmt: skip
def test_other_ways_to_write_the_same(tmp_path: Path, change: Callable[[str], str]) -> None:
    plain, found = read_bvh(write(tmp_path, ARM)), read_bvh(write(tmp_path, change(ARM)))
    np.testing.assert_array_equal(found.offsets, plain.offsets)
    np.testing.assert_array_equal(found.positions, plain.positions)
    np.testing.assert_array_equal(found.rotations, plain.rotations)


def test_channel_order(tmp_path: Path) -> None:
    """The same turns under Xrotation Zrotation mean Rx·Rz; positions may stand last; case does not matter."""
    text = ARM.replace("CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation",
                       "CHANNELS 5 xrotation ZROTATION Zposition Yposition Xposition")
    text = text[: text.index("Frames")] + "Frames: 1\nFrame Time: 0.1\n90 90 7 6 5 0 0 0\n"
    clip = read_bvh(write(tmp_path, text))
    np.testing.assert_allclose(clip.positions[0, 0], [5, 6, 7])
    # Rx(90)·Rz(90)·x = Rx(90)·y = z
    np.testing.assert_allclose(tips(clip), [[5, 6, 14]], atol=1e-12)


def test_positions_on_a_joint(tmp_path: Path) -> None:
    text = ARM.replace("CHANNELS 3 Zrotation Yrotation Xrotation", "CHANNELS 1 Yposition")
    text = text[: text.index("Frames")] + "Frames: 1\nFrame Time: 0.1\n0 0 0 0 0 0 2\n"
    np.testing.assert_allclose(tips(read_bvh(write(tmp_path, text))), [[7, 2, 0]])


def test_resampling(tmp_path: Path) -> None:
    """Halfway between 0° and 90° is 45°; positions are linear; the frames themselves come back."""
    clip = read_bvh(write(tmp_path, ARM))
    np.testing.assert_allclose(clip.at(np.array([0.0, 0.5, 1.0])).rotations, clip.rotations, atol=1e-12)
    half = clip.at(np.array([0.25]))
    s = np.sqrt(0.5)
    np.testing.assert_allclose(half.rotations[0, 1], [[s, -s, 0], [s, s, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(tips(half), [[9 + 3 * s, 3 * s, 0]], atol=1e-12)
    for times in ([-0.1], [0, 1.1], [np.nan], []):
        with pytest.raises(InputError, match="clip arm: found .*expected times from 0 s to 1 s"):
            clip.at(np.array(times))


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("HIERARCHY", "HIERACHY", 1, "'HIERACHY'; expected HIERARCHY"),
        ("ROOT Upper", "JOINT Upper", 2, "'JOINT'; expected ROOT"),
        ("OFFSET 1 2 3", "OFFSET 1 2", 5, "'CHANNELS'; expected three numbers"),
        ("OFFSET 4 0 0", "OFFSET 4 x 0", 8, "'x'; expected three numbers"),
        ("OFFSET 4 0 0", "OFFSET 4 nan 0", 8, "nan; expected"),
        ("CHANNELS 3", "CHANNELS 4", 10, "'End'; expected 4 of Xposition"),
        ("CHANNELS 3", "CHANNELS many", 9, "'many'"),
        ("Zrotation Yrotation Xrotation\n    End", "Zrotation Zrotation Xrotation\n    End", 9,
         "each channel once"),
        ("Xposition Y", "Wposition Y", 5, "'Wposition'"),
        ("JOINT Fore", "JOINT Upper", 6, "second joint 'Upper'"),
        ("End Site", "Site", 10, "'Site'; expected"),
        ("Frames: 3", "Frames: 0", 17, "'0'; expected a number of frames"),
        ("Frames: 3", "Frames: 4", 21, "end of the file; expected frame 4 of 4"),
        ("Frames: 3", "Frames: 999999999", 21, "end of the file"),
        ("Frames: 3", "Frames: " + "9" * 5000, 17, "expected a number of frames"),
        ("Frames: 3", "Frames: ²", 17, "'²'; expected a number of frames"),
        ("CHANNELS 3", "CHANNELS ³", 9, "'³'"),
        ("Time: 0.5", "Time: 0", 18, "frame time above 0"),
        ("10 0 0 0 0 0 90 0 0", "10 0 0 0 0 0 90 0", 20, "8 numbers; expected 9"),
        ("10 0 0 0 0 0 90 0 0", "10 0 0 0 0 0 90 0 0 0", 20, "10 numbers; expected 9"),
        ("10 0 0 0 0 0 90 0 0", "10 0 0 0 0 0 nan 0 0", 20, "'nan' for Fore Zrotation in frame 2; expected"),
        ("10 0 0 0 0 0 90 0 0", "10 0 0 0 0 0 ninety 0 0", 20,
         "'ninety' for Fore Zrotation in frame 2; expected"),
    ],
)
def test_refuses(tmp_path: Path, old: str, new: str, line: int, message: str) -> None:
    assert old in ARM
    with pytest.raises(InputError) as caught:
        read_bvh(write(tmp_path, ARM.replace(old, new, 1)))
    assert f"arm.bvh, line {line}: found" in str(caught.value) and message in str(caught.value)


def chain(depth: int) -> str:
    """A chain of joints, each 1 above the one before, without motion."""
    opened = "".join(f"{'JOINT' if i else 'ROOT'} j{i}\n{{\nOFFSET 0 1 0\n" for i in range(depth))
    return (
        f"HIERARCHY\n{opened}CHANNELS 1 Xrotation\n" + "}\n" * depth + "MOTION\nFrames: 1\nFrame Time: 1\n0\n"
    )


def test_deep_nesting(tmp_path: Path) -> None:
    clip = read_bvh(write(tmp_path, chain(3000)))
    assert len(clip.joint_names) == 3000 and clip.parents.tolist() == list(range(-1, 2999))
    with pytest.raises(InputError,
                       match="end of the file; expected CHANNELS, JOINT, End Site or } of joint j2999"):
        read_bvh(write(tmp_path, chain(3000).split("CHANNELS")[0]))


def test_truncated_anywhere(tmp_path: Path) -> None:
    for end in range(0, len(ARM) - 2, 7):
        try:
            read_bvh(write(tmp_path, ARM[:end]))
        except InputError as error:
            assert "arm.bvh, line" in str(error)
        else:
            pytest.fail(f"accepted {end} of {len(ARM)} characters")


def test_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "binary.bvh").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="as text"):
        read_bvh(tmp_path / "binary.bvh")
