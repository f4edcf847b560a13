"""The settings of a synthetic capture: the performer's look and motion, sizes and splits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.bvh import Clip
from ndf_mi.body.motion import load_clip, pose_sequence
from ndf_mi.body.poses import Poses
from ndf_mi.capture.document import Split
from ndf_mi.capture.synthesise.ring import evenly
from ndf_mi.errors import InputError

#: The clips of the training poses, and the different one of the novel poses.
TRAINING_CLIPS = ("walk", "climb")
NOVEL_CLIP = "jump"
#: First frame of the sequence in that clip: the run-up to the first jump, 20 to 35 mm a frame.
SEQUENCE_START = 24
#: The performer's build: shape coefficients by name; the others are 0.
BUILD = {"height": 0.15, "muscle": 0.2, "sex": -0.1}


@dataclass(frozen=True)
class Settings:
    """The settings that define a synthetic capture.

    Attributes:
        pixels: width and height of the images.
        spp: samples a pixel.
        train_cameras: number of the ``cameras`` in the ring, evenly spaced, for training; the others are the
            novel views.
        view_frames: number of the training ``frames``, evenly spaced, in the novel views.
        pose_frames: number of frames of the other motion for novel poses.
        pose_cameras: number of cameras of the novel poses, evenly spaced among those of the novel views.
        sequence_frames: number of successive frames, at 30 Hz, of the other motion in the split ``sequence``,
            seen by the first camera of the novel poses.
        seed: of the placement of cameras and the sampling of the renderer.
    """

    pixels: int
    spp: int
    cameras: int
    train_cameras: int
    frames: int
    view_frames: int
    pose_frames: int
    pose_cameras: int
    sequence_frames: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        """Raises InputError at the first number that is out of range."""
        ranges = {
            "pixels": (16, 4096), "spp": (1, 16384), "cameras": (1, 99), "train_cameras": (1, self.cameras),
            "frames": (1, 190), "view_frames": (0, self.frames), "pose_frames": (0, 120),
            "pose_cameras": (1, self.cameras - self.train_cameras or self.cameras),
            "sequence_frames": (0, 60), "seed": (0, 2**31 - 1)}  # fmt: skip
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"--{name.replace('_', '-')}", str(value),
                                 f"a whole number from {low} to {high}")


CHOICES = {
    "motion": ("clips", "turn", "still"),
    "clothes": ("loose", "tight", "coat", "skirt"),
    "hair": ("bob", "big", "hat", "none"),
    "surface": ("mixed", "matte", "glossy"),
}


@dataclass(frozen=True)
class Look:
    """The choices that make a performer easier or harder to model; the defaults make the standard one.

    Attributes:
        motion: in the training frames. `clips`: walking and climbing; `turn`: one pose that turns once around
            the vertical; `still`: one pose.
        clothes: `loose` clothes are centimetres away from the body; `tight` ones are within 12 mm; `coat` is
            an open coat over loose trousers, `skirt` a wide skirt below a shirt, both to the calves, with the
            hem at least 15 cm from the standing body.
        folds: whether cloth folds with the pose.
        surface: `mixed`: diffuse cloth with glossy skin, hair and shoes; `matte`: everything is diffuse;
            `glossy`: everything is glossy.
        hair: `bob`, to the chin; `big`, curls, 15 to 20 cm from the head; `hat`, with a wide brim over the
            bob; `none`; or None for a bob, and none with tight clothes.
        bag: whether there is a rucksack on the back, 20 cm deep.
    """

    motion: str = "clips"
    clothes: str = "loose"
    folds: bool = True
    surface: str = "mixed"
    hair: str | None = None
    bag: bool = False

    def __post_init__(self) -> None:
        """Raises InputError at the first unknown choice."""
        for name, known in CHOICES.items():
            value = getattr(self, name)
            if value not in known and not (name == "hair" and value is None):
                raise InputError(f"--{name}", repr(getattr(self, name)), f"one of {', '.join(known)}")

    @property
    def worn_hair(self) -> str:
        """The hair, where the default depends on the clothes."""
        return self.hair or ("none" if self.clothes == "tight" else "bob")

    @property
    def wide(self) -> bool:
        """Whether something is farther from the body than loose clothes and a bob, 7 cm."""
        return self.clothes in ("coat", "skirt") or self.hair in ("big", "hat") or self.bag

    def changes(self) -> dict[str, Any]:
        """The choices that differ from the default, by name."""
        return {name: value for name, value in vars(self).items() if value != getattr(type(self), name)}


SIZES = {
    "tiny": Settings(48, 16, 5, 2, 3, 1, 1, 2, 2),
    "lit": Settings(96, 256, 8, 4, 3, 2, 2, 2),
    "plan": Settings(80, 196, 10, 6, 12, 4, 0, 1),
    "quick": Settings(128, 100, 8, 4, 14, 3, 4, 4, 8),
    "studio": Settings(256, 132, 21, 4, 64, 6, 10, 7, 12),
}


def splits(settings: Settings, names: list[str]) -> dict[str, Split]:
    """Cameras and frames of each split: training frames, then novel poses, then the sequence."""
    train = evenly(names, settings.train_cameras)
    others = tuple(name for name in names if name not in train)
    frames = tuple(range(settings.frames))
    spread = (np.arange(settings.view_frames) + 0.5) / max(settings.view_frames, 1) * settings.frames
    viewed = tuple(int(frame) for frame in spread)
    start = settings.frames + settings.pose_frames
    posed = tuple(range(settings.frames, start))
    sequence = tuple(range(start, start + settings.sequence_frames))
    posing = evenly(others or train, settings.pose_cameras)
    chosen = {"train": (train, frames), "novel_view": (others, viewed), "novel_pose": (posing, posed),
              "sequence": (posing[:1], sequence)}
    return {name: Split(*both) if all(both) else Split() for name, both in chosen.items()}


def shape_of(body: Body) -> np.ndarray:
    """(B,) float32 shape coefficients of the performer."""
    return np.array([BUILD.get(name, 0.0) for name in body.shape_names or ()], dtype=np.float32)


def motion(body: Body, settings: Settings, kind: str = "clips") -> Poses:
    """The posed body in every frame: of the training clips, of the novel one, and of its sequence.

    In every frame the lowest point is at height 0 and the hips are over the origin.

    Args:
        kind: motion of the training frames, as in `Look`; all but `clips` keep the pose of the first frame.
    """
    first = settings.frames - settings.frames // 2
    counts = [(TRAINING_CLIPS[0], first), (TRAINING_CLIPS[1], settings.frames - first),
              (NOVEL_CLIP, settings.pose_frames)]
    shown = [(clip := load_clip(name), _times(clip, count)) for name, count in counts if count]
    if settings.sequence_frames:
        shown.append((load_clip(NOVEL_CLIP), SEQUENCE_START + np.arange(settings.sequence_frames)))
    shape = shape_of(body)
    parts = [pose_sequence(body, clip, frames, rate=30.0, shape=shape, place="treadmill")
             for clip, frames in shown]
    if kind != "clips":
        turn = 2 * np.pi / settings.frames if kind == "turn" else 0.0
        parts[: 2 if settings.frames > 1 else 1] = [_held(parts[0], turn * np.arange(settings.frames))]

    vertices, pose, root_rotation, translation = (
        np.concatenate([getattr(part, field) for part in parts])
        for field in ("vertices", "pose", "root_rotation", "translation"))
    # Without this, the performer would leave the image in a jump or a climb.
    lift = np.array([0, 1, 0], dtype=np.float32) * vertices[..., 1].min(axis=1)[:, None]
    return Poses(np.arange(len(vertices)), vertices - lift[:, None], pose, root_rotation, translation - lift,
                 shape)


def heading(root_rotation: np.ndarray) -> float:
    """The angle from +z towards +x, radians, at which a body with `root_rotation` (3,) faces."""
    forward = Rotation.from_rotvec(root_rotation).apply([0.0, 0.0, 1.0])
    return float(np.arctan2(forward[0], forward[2]))


def _held(poses: Poses, angles: np.ndarray) -> Poses:
    """The pose of the first frame, rotated around the world's y axis by (T,) radians."""
    turn = Rotation.from_rotvec(angles[:, None] * [0.0, 1.0, 0.0])
    return Poses(np.arange(len(angles)), np.einsum("tij,vj->tvi", turn.as_matrix(), poses.vertices[0]),
                 np.repeat(poses.pose[:1], len(angles), axis=0),
                 (turn * Rotation.from_rotvec(poses.root_rotation[0])).as_rotvec(),
                 turn.apply(poses.translation[0]), poses.shape)


def _times(clip: Clip, count: int) -> np.ndarray:
    """``count`` frames of a clip at 30 Hz, in the middles of equal intervals."""
    return np.round((np.arange(count) + 0.5) / count * int(clip.duration * 30)).astype(int)
