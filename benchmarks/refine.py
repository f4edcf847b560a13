"""How much of what a wrong fit costs is brought back by refining it.

    python benchmarks/refine.py CAPTURE --steps 2000 --seeds 0 1

Perturbs a capture's fit in memory: joint angles and place by noise that changes slowly over the frames,
and the training cameras. Trains on the original fit, on the perturbed one, and on the perturbed one with
`refine`, with steps in turn. Prints errors on the training rays, on held-back training views and, unless
`--no-held-out`, on novel views of training frames, with the share of the loss that refining brings back;
and how far joints and cameras are from the unperturbed ones as perturbed, after the outlines of masks and
after the field. `--steps 0` stops after the outlines.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from ndf_mi import variants

variants.use()

from ndf_mi.body.body import Body  # noqa: E402
from ndf_mi.body.poses import Poses  # noqa: E402
from ndf_mi.body.skinning import joint_transforms, skin  # noqa: E402
from ndf_mi.capture.camera import Camera  # noqa: E402
from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.commands.training_options import configured  # noqa: E402
from ndf_mi.experiments.metrics import box_mask, psnr  # noqa: E402
from ndf_mi.learn.camera_corrections import corrected  # noqa: E402
from ndf_mi.learn.loop import start  # noqa: E402
from ndf_mi.learn.refined import refined_camera  # noqa: E402
from ndf_mi.learn.trainer import Trainer  # noqa: E402
from ndf_mi.methods.ndf import NeuralField  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is perturbed and trained."""

    capture: Annotated[Path, tyro.conf.Positional]
    """A capture's folder; its fit is the truth."""

    steps: int = 2000
    """Steps of each training."""

    seeds: tuple[int, ...] = (0,)
    """Seeds of the perturbation and of the training."""

    refine: str = "pose,cameras"
    """What is refined; shape is not perturbed."""

    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """NAME=VALUE, as for `ndf-mi optimise`, for all trainings."""

    joints: float = 5.0
    """Standard deviation of the joints' noise in degrees."""

    shift: float = 15.0
    """Standard deviation of the body's shift in millimetres."""

    turn: float = 0.3
    """Angle by which each training camera is turned, in degrees."""

    move: float = 5.0
    """Distance by which each training camera is moved, in millimetres."""

    only: tuple[str, ...] = ("clean", "perturbed", "refined")
    """Which of the trainings to run."""

    held_out: bool = True
    """Measure novel views. Leave out to choose options by the other figures."""


def main(options: Options) -> None:
    """Trains and prints."""
    truth = Capture.read(options.capture)
    for seed in options.seeds:
        wrong = perturbed(truth, options, seed)
        with tempfile.TemporaryDirectory() as folder:
            trainers = {name: trainer(Path(folder) / name, truth if name == "clean" else wrong,
                                      options, seed, refine=name == "refined")
                        for name in ("clean", "perturbed", "refined") if name in options.only}
            given = [wrong.cameras[name] for name in wrong.splits["train"].cameras]
            print(f"seed {seed} perturbed: {fit_error(truth, wrong.poses, given)}", flush=True)
            if "refined" in trainers:
                new = trainers["refined"]
                print(f"    after the outlines: {fit_error(truth, new.run.poses, cameras_of(new, wrong))}, "
                      f"{new.progress.seconds:.1f} s with the reference surface", flush=True)
            if not options.steps:
                continue
            seconds = dict.fromkeys(trainers, 0.0)
            for _ in range(options.steps):
                for name, each in trainers.items():
                    begun = time.perf_counter()
                    each.step()
                    seconds[name] += time.perf_counter() - begun
            report(trainers, truth, wrong, seed, seconds, options)


def trainer(folder: Path, capture: Capture, options: Options, seed: int, refine: bool) -> Trainer:
    """A new training of the preset `fast`."""
    names = tuple(options.refine.split(",")) if refine else None
    preset, training = configured("fast", options.option, steps=max(options.steps, 1), seed=seed,
                                  refine=names)
    return start(folder, capture, preset, training)


def perturbed(capture: Capture, options: Options, seed: int) -> Capture:
    """The capture with a wrong fit in its training frames and wrong training cameras."""
    rng = np.random.default_rng([seed, 7])
    body, poses, split = capture.body, capture.poses, capture.splits["train"]
    joints = body.joint_count
    rows = [poses.index(frame) for frame in split.frames]
    angles = np.radians(options.joints) * slow(rng, len(rows), (joints, 3))
    angles[:, 0] = 0
    pose, shift, vertices = poses.pose.copy(), poses.translation.copy(), poses.vertices.copy()
    pose[rows] += angles
    shift[rows] += 1e-3 * options.shift * slow(rng, len(rows), (3,))
    for row in rows:
        moved, there = (np.asarray(skin(body, *fit, poses.shape)).reshape(-1, 3) for fit in (
            (pose[row], poses.root_rotation[row], shift[row]),
            (poses.pose[row], poses.root_rotation[row], poses.translation[row])))
        vertices[row] += moved - there
    cameras = []
    for name in split.cameras:
        axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        cameras.append(corrected(capture.cameras[name], np.radians(options.turn) * axis,
                                 1e-3 * options.move * way, 0.0))
    wrong = dataclasses.replace(poses, pose=pose, translation=shift, vertices=vertices)
    return capture.with_body(body, wrong).with_cameras(cameras)


def slow(rng: np.random.Generator, frames: int, shape: tuple[int, ...]) -> np.ndarray:
    """(T, *shape) waves of unit variance, each of a random phase and of half to two periods in T frames."""
    periods, phases = rng.uniform(0.5, 2.0, shape), rng.uniform(0, 2 * np.pi, shape)
    at = np.arange(frames).reshape(-1, *[1] * len(shape)) / frames
    return np.asarray(np.sqrt(2) * np.sin(2 * np.pi * at * periods + phases))


def report(trainers: dict[str, Trainer], truth: Capture, wrong: Capture, seed: int, seconds: dict[str, float],
           options: Options) -> None:
    """Prints a line a training, and what refining brings back."""
    novel: dict[str, float] = {}
    split = truth.splits["novel_view"]
    for name, each in trainers.items():
        each.publish()
        now = each.progress
        held = "" if now.kept_psnr is None else f", held-back {now.kept_psnr:.2f} dB at {now.kept_step}"
        text = (f"seed {seed} {name:9s}: {1000 * seconds[name] / options.steps:.0f} ms a step, "
                f"training rays {now.psnr:.2f} dB{held}")
        if options.held_out:
            field = NeuralField.of(each.run)
            scores = [psnr(truth.image(camera, frame), field.render(truth.cameras[camera], frame),
                           box_mask(truth.cameras[camera], truth.poses.vertices[truth.poses.index(frame)]))
                      for camera in split.cameras for frame in split.frames]
            novel[name] = float(np.mean(scores))
            text += f", novel views {novel[name]:.2f} dB"
        print(text, flush=True)
        if name == "refined":
            print(f"    after the field: {fit_error(truth, each.run.poses, cameras_of(each, wrong))}",
                  flush=True)
    if len(novel) == 3:
        share = (novel["refined"] - novel["perturbed"]) / (novel["clean"] - novel["perturbed"])
        print(f"seed {seed}: refining brings back {100 * share:.0f} % of what the perturbation cost",
              flush=True)


def joint_error(truth: Capture, poses: Poses) -> float:
    """Mean distance of the joints in the training frames, mm."""
    return 1000 * float(np.mean([
        np.linalg.norm(joints(truth.body, poses, frame) - joints(truth.body, truth.poses, frame), axis=1)
        for frame in truth.splits["train"].frames]))


def joints(body: Body, poses: Poses, frame: int) -> np.ndarray:
    """(J, 3) joints in a frame, world, metres."""
    row = poses.index(frame)
    matrices = joint_transforms(body, poses.pose[row], poses.root_rotation[row], poses.translation[row],
                                poses.shape).matrices
    rows = np.asarray(matrices).reshape(-1, 3, 4)
    rest = np.asarray(body.joints, np.float64)
    if body.joint_dirs is not None and poses.shape is not None:
        rest = rest + body.joint_dirs @ poses.shape
    return np.einsum("jab,jb->ja", rows[:, :, :3], rest) + rows[:, :, 3]


def fit_error(truth: Capture, poses: Poses, cameras: list[Camera]) -> str:
    """Mean distances of joints and training cameras from the true ones, and the cameras' angle."""
    turns = [Rotation.from_matrix(truth.cameras[camera.name].transform[:3, :3].T
                                  @ camera.transform[:3, :3]).magnitude() for camera in cameras]
    moves = [np.linalg.norm(truth.cameras[camera.name].position - camera.position) for camera in cameras]
    return (f"joints {joint_error(truth, poses):.1f} mm, cameras {np.degrees(np.mean(turns)):.2f} degrees "
            f"and {1000 * float(np.mean(moves)):.1f} mm")


def cameras_of(trainer: Trainer, capture: Capture) -> list[Camera]:
    """The training cameras as the run has them."""
    return [refined_camera(trainer.run, capture.cameras[name]) for name in capture.splits["train"].cameras]


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
