"""Makes a capture of a character: plays it, fits Anny, renders all splits, and writes the folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi.body.anny import load_anny
from ndf_mi.capture.document import FILE_NAME, Document
from ndf_mi.capture.synthesise import lighting, plan
from ndf_mi.capture.synthesise.character.character import Character
from ndf_mi.capture.synthesise.character.fit import Target, fit
from ndf_mi.capture.synthesise.character.frames import choose_spans, fitting, transforms
from ndf_mi.capture.synthesise.character.report import describe_fit
from ndf_mi.capture.synthesise.character.skin import Mesh, Skin
from ndf_mi.capture.synthesise.layers import Layer
from ndf_mi.capture.synthesise.ring import camera_ring
from ndf_mi.capture.synthesise.studio import Studio
from ndf_mi.capture.synthesise.synthesise import (
    BACKGROUND,
    FIT_FILE,
    SETTINGS_FILE,
    claim,
    render_missing,
)
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.errors import InputError
from ndf_mi.files import write_json
from ndf_mi.json_input import load_json

#: Increased whenever the same settings give other pictures or another body.
RECIPE = 2
_SKIN_POINTS = 12_000


@dataclass(frozen=True)
class Source:
    """What is shown.

    Attributes:
        file: a glTF file with a skinned, animated mesh.
        animation, novel_animation: names of the animations for training and for novel poses; by default
            those with most movement.
        joints: a JSON file that names nodes for Anny's joints, or None.
    """

    file: Path
    animation: str | None = None
    novel_animation: str | None = None
    joints: Path | None = None

    def made_with(self) -> dict[str, Any]:
        """The settings that tell captures apart; the file by its SHA-256. Raises InputError if it cannot be
        read."""
        try:
            digest = hashlib.sha256(self.file.read_bytes()).hexdigest()
        except OSError as error:
            raise InputError(self.file, f"a file that cannot be read ({error.strerror})",
                             "a glTF 2.0 file (.glb or .gltf)") from None
        joints = None if self.joints is None else load_json(self.joints, "a JSON object of names")
        return {"character": digest, "animation": self.animation, "novel_animation": self.novel_animation,
                "joints": joints}


def synthesise_character(
    out: Path,
    source: Source,
    settings: plan.Settings,
    name: str = "character",
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    light: str = lighting.DEFAULT,
    fitting_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Makes a capture of a character in ``out``, or continues an interrupted call. Arguments are those of
    `synthesise`.

    Args:
        fitting_progress: called with the numbers of finished and of all steps of the fit.

    Returns:
        The figures of `describe_fit`, and ``notes``: sentences on what was left out or changed.

    Raises:
        InputError: ``out`` holds something else; the character cannot be read, has no human rig or no
            animation; no such light.
    """
    out = Path(out)
    constant = lighting.light(light).constant
    made_with = {"name": name, "character_recipe": RECIPE, "mitsuba": metadata.version("mitsuba"),
                 **asdict(settings), **source.made_with(), "light": light}
    claim(out, made_with, overwrite)
    if (out / FILE_NAME).is_file():
        progress(1, 1)
        return load_json(out / FIT_FILE, "figures of a fit")
    character = Character(source.file, source.joints)
    training, novel = choose_spans(character, source.animation, source.novel_animation)
    settings = fitting(settings, novel, character.notes)
    world = on_treadmill(character, transforms(character, settings, training, novel))
    mesh = whole(character, world)
    if not np.isfinite(mesh.vertices).all():
        raise InputError(source.file, "vertices that are not finite when posed", "finite numbers")
    write_json(out / SETTINGS_FILE, made_with)
    target = Target(character.joints, character.bind, world, Skin(mesh, _SKIN_POINTS, settings.seed))
    body, poses = fit(load_anny(measures=True), target, fitting_progress)

    cameras = camera_ring(settings.cameras, settings.pixels, mesh.vertices, settings.seed)
    scene = lighting.SCENE if constant else None
    document = Document(name, BACKGROUND, cameras, plan.splits(settings, list(cameras)), lighting=scene)

    def make_studio() -> tuple[Studio, Callable[[int], None]]:
        studio = Studio(layers(character, mesh), settings.spp, light)
        borders = np.cumsum([len(part.rest) for part in character.parts])[:-1]

        def pose(frame: int) -> None:
            studio.pose(np.split(mesh.vertices[frame].astype(np.float32), borders),
                        plan.heading(poses.root_rotation[frame]), np.split(mesh.normals(frame), borders))

        return studio, pose

    writer = CaptureWriter(out, document)
    render_missing(writer, make_studio, settings.seed, progress)
    if constant:
        lighting.write(out, light)
    figures = {"training": training.animation.name, "novel": novel.animation.name, "notes": character.notes,
               **describe_fit(body, poses, target, mesh, list(cameras.values()))}
    write_json(out / FIT_FILE, figures)
    writer.finish(body, poses)
    return figures


def on_treadmill(character: Character, world: np.ndarray) -> np.ndarray:
    """Moves (T, N, 4, 4) so that in each frame the hips are over the origin and the lowest point is at 0."""
    hips = world[..., :3, 3][:, [character.joints["LeftUpLeg"], character.joints["RightUpLeg"]]].mean(axis=1)
    moved = world.copy()
    moved[:, :, [0, 2], 3] -= hips[:, None, [0, 2]]
    lowest = np.min([vertices[..., 1].min(axis=1) for vertices in character.vertices(world)], axis=0)
    moved[:, :, 1, 3] -= lowest[:, None]
    return moved


def whole(character: Character, world: np.ndarray) -> Mesh:
    """All parts as one mesh, in the frames of ``world``, (T, N, 4, 4)."""
    faces, same, count, points = [], [], 0, 0
    for part in character.parts:
        faces.append(part.faces + count)
        same.append(part.same + points)
        count, points = count + len(part.rest), points + int(part.same.max()) + 1
    vertices = np.concatenate(character.vertices(world), axis=1)
    return Mesh(vertices, np.concatenate(faces), np.concatenate(same))


def layers(character: Character, mesh: Mesh) -> list[Layer]:
    """The parts for the studio, in the first frame."""
    start = 0
    out = []
    for part in character.parts:
        rest = mesh.vertices[0, start : start + len(part.rest)]
        start += len(part.rest)
        out.append(Layer(part.name, part.material, part.faces, rest, np.ones((len(rest), 1)), part.colour,
                         uv=part.uv, picture=part.picture))
    return out
