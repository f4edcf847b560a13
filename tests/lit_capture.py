"""Captures of a ball of known density and albedo under known lights, rendered by Mitsuba's `volpath`."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from sphere_capture import ring_camera

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Document, Split
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.methods.lit import LitRenderer

SIZE = 24
BACKGROUND = (0.5, 0.5, 0.5)
LIGHTS = {
    "day": '<emitter type="constant"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>'
    '<emitter type="directional"><vector name="direction" value="-0.5, -0.7, -0.6"/>'
    '<rgb name="irradiance" value="3, 2.7, 2.2"/></emitter>',
    "night": '<emitter type="constant"><rgb name="radiance" value="0.1, 0.15, 0.25"/></emitter>'
    '<emitter type="directional"><vector name="direction" value="0.9, -0.2, 0.4"/>'
    '<rgb name="irradiance" value="4, 2, 0.8"/></emitter>',
}


@pytest.fixture(scope="session")
def drawn() -> dict[str, Path]:
    """Folders of captures that are already rendered, by a digest of what they show."""
    return {}


@pytest.fixture
def lit_capture(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, drawn: dict[str, Path]
) -> Callable[..., Capture]:
    """Renders the field of a saved run, under one of `LIGHTS`: two training frames, one also a novel view.

    Two samples a pixel are enough to look at, not to learn from. The same capture is rendered once a session.
    """

    def make(run: Any, light: str, spp: int = 2) -> Capture:
        key = hashlib.sha256(f"{light} {spp} {run.config['preset']}".encode())
        for name, values in sorted(run.field_tensors().items()):
            key.update(name.encode() + values.tobytes())
        known = drawn.get(key.hexdigest())
        if known is None:
            known = drawn[key.hexdigest()] = draw(run, light, spp, tmp_path_factory.mktemp("drawn") / light)
        shutil.copytree(known, tmp_path / light)
        return Capture.read(tmp_path / light)

    def draw(run: Any, light: str, spp: int, folder: Path) -> Path:
        cameras = {
            c.name: c for c in (ring_camera(f"c{i}", 1.57 * i, 0.5 * (-1) ** i, SIZE) for i in range(4))
        }
        cameras["n0"] = ring_camera("n0", 0.8, size=SIZE)
        splits = {"train": Split(("c0", "c1", "c2", "c3"), (0, 1)), "novel_view": Split(("n0",), (1,))}
        document = Document(
            name="ball", background=BACKGROUND, cameras=cameras, splits=splits, lighting="lighting.xml"
        )
        files.write_text(folder / "lighting.xml", f'<scene version="3.0.0">{LIGHTS[light]}</scene>')
        writer = CaptureWriter(folder, document)
        whole = np.ones((SIZE, SIZE), dtype=bool)
        for frame in (0, 1):
            scene = mi.load_dict(
                {
                    "type": "scene",
                    "lights": mi.load_file(str(folder / "lighting.xml")).emitters()[0],
                    "sun": mi.load_file(str(folder / "lighting.xml")).emitters()[1],
                    "performer": {
                        "type": "ndf_shell",
                        "layers": 4,
                        "interior": {"type": "ndf", "run": str(run.path), "frame": frame},
                    },
                }
            )
            path = mi.load_dict({"type": "volpath", "max_depth": 6, "hide_emitters": True})
            for camera in (camera for camera, of in document.images() if of == frame):
                image, _ = LitRenderer(scene, path, np.array(BACKGROUND), spp).render(
                    cameras[camera], whole, frame
                )
                mask = np.abs(image - BACKGROUND).max(-1) > 0.02
                mask[SIZE // 2, SIZE // 2] = True
                writer.write(camera, frame, np.where(mask[..., None], image, BACKGROUND), mask)
        writer.finish(run.body, run.poses)
        return folder

    return make
