"""Studies made by hand: records, pictures of a few pixels, and a capture that they are compared with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import Flicker, FrameSequence, Measured, MethodResult, Results, View
from ndf_mi.experiments.trade.results import Figures, Row, Trade

WIDTH, HEIGHT = 24, 20
SEQUENCE = FrameSequence("novel_pose", "side", (3, 4, 5))
VIEWS = [
    View("novel_view", "side", 1),
    View("novel_view", "side", 2),
    View("novel_pose", "side", 3),
    View("train", "front", 1),
]


def camera(name: str) -> Camera:
    """A camera at 2 m that sees a box of 0.4 m in the middle of its image."""
    transform = np.eye(4)
    transform[2, 3] = 2.0
    return Camera(name, WIDTH, HEIGHT, 40.0, 40.0, WIDTH / 2, HEIGHT / 2, transform)


@pytest.fixture(scope="session")
def truth() -> SimpleNamespace:
    """What reports need of a capture: cameras, poses and images that change from frame to frame."""
    corners = 0.2 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), np.float32).reshape(3, -1).T
    frames = np.arange(1, 6, dtype=np.int32)
    shifts = 0.01 * frames[:, None, None] * np.array([1, 0, 0], np.float32)
    zeros = np.zeros((5, 3), np.float32)
    poses = Poses(frames, corners[None] + shifts, np.zeros((5, 1, 3), np.float32), zeros, zeros)

    def image(name: str, frame: int) -> np.ndarray:
        x = np.linspace(0, 1, WIDTH, dtype=np.float32)
        return np.stack(HEIGHT * [np.stack([0.2 + 0.5 * x, 0.1 * frame + 0 * x, 0.6 - 0.5 * x], -1)])

    cameras = {name: camera(name) for name in ("front", "side")}
    return SimpleNamespace(
        name="dancer", digest="0123456789abcdef" * 4, cameras=cameras, poses=poses, image=image
    )


def write_picture(file: Path, image: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)).save(file)


@pytest.fixture
def add_method(truth: SimpleNamespace, tmp_path: Path) -> Callable[..., MethodResult]:
    """Makes a method whose pictures are the truth plus a constant, with figures of images and a sequence."""

    def add(key: str, label: str, shift: float, **metadata: object) -> MethodResult:
        psnr = -20 * np.log10(shift) if shift else np.inf
        result = MethodResult(key, label, f"key of {key}", dict(metadata))
        for view in dict.fromkeys([*VIEWS, *SEQUENCE.views]):
            write_picture(tmp_path / key / view.file, truth.image(view.camera, view.frame) + shift)
            figures = dict.fromkeys(metrics.IMAGE_METRICS, 0.5) | {
                "box_psnr": psnr, "psnr": psnr + 1, metrics.LPIPS: None}
            result.images.append(Measured(view, 0.25, figures, sampled=view in VIEWS))
        result.flicker = [Flicker(SEQUENCE, [psnr + 3, None], [21.0, 22.0])]
        return result

    return add


@pytest.fixture
def about() -> dict[str, object]:
    """What a study knows of its circumstances."""
    return {
        "run": "runs/a<b",
        "capture": {
            "name": "dancer",
            "digest": "0123456789abcdef" * 4,
            "path": "captures/dancer",
            "train": {"cameras": 1, "frames": 1},
        },
        "measured": {"novel_view": 2, "novel_pose": 1, "train": 1},
        "protocol": {
            "name": "default",
            "description": "All images.",
            "headline": ["box_psnr", "box_flip"],
            "notes": ["A `note` on the protocol."],
        },
        "equal_seconds": 61.0,
        "settings": {"texture": 64},
        "training": {"steps": 1000},
        "command": "ndf-mi compare 'runs/a<b'",
        "machine": {"Cores": "2"},
    }


@pytest.fixture
def results(add_method: Callable[..., MethodResult], about: dict[str, object]) -> Results:
    """A field, a mesh that converged early, and a method without training that reports don't know."""
    history = [[step, step / 10, 0.1 / step] for step in (1, 2, 3, 4)]
    methods = [
        add_method("ndf", "NDF", 0.1, seconds=61.0, steps=1000, history=history),
        add_method(
            "mesh-converged",
            "Mesh, to convergence",
            0.01,
            seconds=12.5,
            steps=100,
            converged=True,
            budget=None,
            history=history,
            note="Learning rate 0.1.",
            sweep={"0.1": 0.002},
        ),
        add_method("surprise", "Gaussian <surprise>", 0.0, holes={"count": 3}),
    ]
    return Results(about, methods)


@pytest.fixture
def trade(truth: SimpleNamespace, tmp_path: Path) -> Trade:
    """Renderings of a run (one dominated, one timed elsewhere), two fields, and a path-traced rendering.

    Their pictures, and those to which they are compared, are in the folder `pictures`.
    """
    views = [VIEWS[0], VIEWS[2]]

    def row(
        key: str, field: str, seconds: float, psnr: float, session: str = "now", paths: bool = False
    ) -> Row:
        truths = {} if paths else {"box_psnr": psnr, "box_ssim": 0.9, "box_flip": 0.1}
        figures = [Figures(view, truths, psnr + 10, None if paths else 31.0) for view in views]
        metadata = {"steps": 500, "training_seconds": 12.0, "loading": 0.5 if paths else None}
        made = Row(key, "axis", f"{key} samples", field, {"spp": 1}, paths, key, metadata, 3 * 2**20, figures)
        made.seconds, made.session = [seconds, 3 * seconds], session
        for view in views:
            image = truth.image(view.camera, view.frame)
            shown = image[::2, ::2] if paths else image
            write_picture(tmp_path / "pictures" / key / view.file, shown + 0.1)
            write_picture(tmp_path / "pictures" / made.reference / view.file, shown + 0.05)
        return made

    rows = [
        row("usual", "run", 0.4, 30.0),
        row("8", "run", 0.1, 20.0),
        row("16", "run", 0.2, 28.0),
        row("slow", "run", 0.6, 29.0),
        row("elsewhere", "run", 0.01, 50.0, session="before"),
        row("own", "own", 0.4, 25.0),
        row("wide", "wide", 0.8, 26.0),
        row("path", "run", 2.0, 22.0, paths=True),
    ]
    sessions = {
        "now": {"machine": {"Cores": "2"}, "timed": 1},
        "before": {"machine": {"Cores": "64"}, "timed": 1},
    }
    about = {
        "run": {"path": "runs/a<b", "preset": "tiny", "digest": "0123456789abcdef" * 4},
        "capture": {"name": "dancer", "digest": "0123456789abcdef" * 4},
        "views": [{"split": view.split, "camera": view.camera, "frame": view.frame} for view in views],
        "size": [WIDTH, HEIGHT],
        "settings": {"repeats": 2},
        "sessions": sessions,
        "session": "now",
        "paths": True,
        "lit": False,
        "command": "ndf-mi tradeoff 'runs/a<b'",
        "machine": {"Cores": "2"},
    }
    return Trade(about, rows)
