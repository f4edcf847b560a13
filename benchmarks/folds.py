"""How much of a synthetic capture's images depends on folds that follow the pose, which a field without pose
must lose.

    python benchmarks/folds.py captures/studio --images 12

Renders the performer again in held-out images: unchanged with another seed, and with each fold at its mean
over the training frames, which is all that a field without pose features can know. Sagging and shadows still
follow the pose. Prints box PSNR against the capture's images, means over each split. The first is the images'
noise. The second bounds the cost of leaving the pose out: the mean squared error e of a field that had the
folds right grows to at most e + 10^(−PSNR/10).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

from ndf_mi.body.anny import load_anny  # noqa: E402
from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.capture.synthesise import plan  # noqa: E402
from ndf_mi.capture.synthesise.performer import Performer  # noqa: E402
from ndf_mi.capture.synthesise.studio import Studio  # noqa: E402
from ndf_mi.capture.synthesise.synthesise import composite  # noqa: E402
from ndf_mi.capture.synthesise.wrinkles import Folds  # noqa: E402
from ndf_mi.experiments import metrics  # noqa: E402
from ndf_mi.experiments.evaluate import choose_views  # noqa: E402
from ndf_mi.experiments.records import SPLITS, View  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is measured."""

    capture: Annotated[Path, tyro.conf.Positional]
    """A folder that `ndf-mi capture synthesise` made, under its default light."""

    images: int = 12
    """Images of each held-out split."""

    seed: int = 0
    """Seed for choosing the images."""

    spp: int = 132
    """Samples a pixel."""


class HeldFolds(Folds):
    """Folds with fixed coefficients (K,), whatever the pose."""

    def __init__(self, folds: Folds, coefficients: np.ndarray) -> None:
        self.fields = folds.fields
        self._held = coefficients

    def coefficients(self, pose: dict[str, np.ndarray]) -> np.ndarray:
        return self._held


def main(options: Options) -> None:
    """Renders, compares and prints a table."""
    capture = Capture.read(options.capture)
    body = load_anny()
    moving, held = (Performer(body, plan.shape_of(body)) for _ in range(2))
    for i, layer in enumerate(held.layers):
        if layer.folds is not None:
            all_poses = np.array([layer.folds.coefficients(named_pose(capture, frame))
                                  for frame in capture.splits["train"].frames])
            change = layer.folds.fields @ (all_poses - all_poses.mean(0)).T
            print(f"{layer.name}: folds of "
                  f"{1e3 * np.sqrt(np.square(layer.folds.fields @ all_poses.T).mean()):.1f} mm, of which "
                  f"{1e3 * np.sqrt(np.square(change).mean()):.1f} mm change with the pose (root mean "
                  "squares)")
            held.layers[i] = dataclasses.replace(layer, folds=HeldFolds(layer.folds, all_poses.mean(0)))
    studio = Studio(moving.layers, options.spp)
    views = choose_views(capture, options.images, options.seed)
    rows = np.array([[box_psnr(capture, studio, performer, view) for performer in (moving, held)]
                     for view in views])
    print("| | rendered again | with mean folds |\n| --- | --- | --- |")
    for split in dict.fromkeys(view.split for view in views):
        again, mean = rows[[view.split == split for view in views]].mean(0)
        print(f"| {SPLITS[split]} | {again:.2f} | {mean:.2f} |")


def named_pose(capture: Capture, frame: int) -> dict[str, np.ndarray]:
    """Axis-angles (3,) of the frame's joints by name."""
    assert capture.body.joint_names is not None
    pose = capture.poses.pose[capture.poses.index(frame)].astype(np.float64)
    return dict(zip(capture.body.joint_names, pose, strict=True))


def box_psnr(capture: Capture, studio: Studio, performer: Performer, view: View) -> float:
    """Box PSNR in dB of the rendered performer against the capture's image."""
    poses, camera = capture.poses, capture.cameras[view.camera]
    row = poses.index(view.frame)
    studio.pose(performer.pose(poses.pose[row], poses.root_rotation[row], poses.translation[row],
                               poses.vertices[row]))
    # The capture's images have seeds below 2**31 - 1.
    image = composite(*studio.render(camera, 2**31 - 1)).astype(np.float32)
    box = metrics.box_mask(camera, poses.vertices[row])
    psnr = metrics.measure(capture.image(view.camera, view.frame), image, box)["box_psnr"]
    assert psnr is not None
    return psnr


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
