"""Training primitives on views of the training split, one a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.methods.gaussians.compositing import Hits, Posed, composite
from ndf_mi.methods.gaussians.densify import densify
from ndf_mi.methods.gaussians.hits import Rectangle, find_hits
from ndf_mi.methods.gaussians.pose_network import PoseNetwork
from ndf_mi.methods.gaussians.primitives import (
    LEARNED,
    LIGHT,
    Arrays,
    Binding,
    Rig,
    areas,
    initial,
    pose,
    rows,
    spread,
)
from ndf_mi.methods.volume.optimisation import Optimisation, Outcome, Schedule
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.training_views import TrainingViews

MARGIN = 0.12
"""Metres around the body that training images show."""

PIXELS = 1 << 14
"""Most pixels of a step: of larger views a strip is drawn."""


@dataclass(frozen=True)
class Settings:
    """How primitives are made and trained.

    Attributes:
        spacing: pixels of the training views between primitives.
        first: most primitives at first. Where `spacing` asks for more, rounds of splitting add them.
        smallest: pixels, least standard deviation of a primitive.
        opacity_weight: weight of the mean squared difference of opacity and mask, away from the masks' edges.
        rounds: how often invisible primitives are removed and as many others split, evenly over the first
            `densified` of the training.
        densified: a share of the training.
        most: largest number of primitives.
        surface: what primitives are bound to: `offset`, the body with offsets that are fitted to the training
            masks first, or `body`.
        pose_noise: radians, standard deviation of the noise that the pose network sees added to joint angles
            in training.
        schedule: rates and length.
    """

    spacing: float = 1.7
    first: int = 12000
    smallest: float = 0.1
    opacity_weight: float = 0.05
    rounds: int = 8
    densified: float = 0.6
    most: int = 40000
    surface: Literal["body", "offset"] = "offset"
    pose_noise: float = 0.1
    schedule: Schedule = Schedule(steps=3000, learning_rate=1e-2, decay=0.03)


NETWORK, SHADE = "network", "light"
"""Names of the pose network's weights and of the light among the parameters."""

RATES = {"offset": 2.0, "logit_opacity": 5.0, "feature": 0.5, NETWORK: 0.1, SHADE: 0.5}
"""Factors on the learning rate by name; 1 where there is none."""


@dataclass(frozen=True)
class Splats:
    """Primitives for the performer of a capture, without what is learned.

    Attributes:
        rig: the body in its poses.
        network: what the pose changes.
        spacing, smallest: metres, as for `primitives.pose`.
        wanted: number of primitives at the end.
    """

    rig: Rig
    network: PoseNetwork
    spacing: float
    smallest: float
    wanted: int

    @classmethod
    def for_capture(cls, capture: Capture, settings: Settings) -> Splats:
        """For a capture, whose body and poses are those of the surface to start on."""
        pixel = pixel_size(capture)
        area = areas(capture.poses.vertices[0], capture.body.faces).sum()
        wanted = max(min(round(area / (settings.spacing * pixel)**2), settings.most), 1)
        spacing = float(np.sqrt(area / min(wanted, settings.first)))
        rig = Rig(capture.body.faces, capture.poses, RestFrames(capture).vertices)
        network = PoseNetwork(capture.poses.pose.shape[1], LEARNED["feature"])
        return cls(rig, network, spacing, settings.smallest * pixel, wanted)

    def spread(self, rng: np.random.Generator) -> Binding:
        """Primitives all over the surface, `spacing` apart."""
        return spread(self.rig.poses.vertices[0], self.rig.faces, self.spacing, rng)

    def at(self, binding: Binding, parameters: Mapping[str, mi.Float], frame: int,
           noise: np.ndarray | float = 0.0) -> Posed:
        """The primitives at a frame, attached to the parameters: what is learned of primitives, flat, the
        network's weights, and the light.

        Args:
            noise: (J, 3) radians, added to the joint angles that the network sees.

        Raises:
            InputError: there is no such frame.
        """
        frames, learned = self.rig.frames(binding, frame), rows(parameters)
        angles = self.rig.poses.pose[self.rig.poses.index(frame)] + noise
        change = self.network(parameters[NETWORK], self.rig.at_rest(binding), learned["feature"],
                              frames.normal, angles)
        return pose(learned, parameters[SHADE], frames, self.spacing, self.smallest, change)


def pixel_size(capture: Capture) -> float:
    """Metres that a pixel of the training views sees at the body, the median over the cameras."""
    split = capture.splits["train"]
    centre = capture.poses.vertices[capture.poses.index(split.frames[0])].mean(axis=0)
    cameras = [capture.cameras[name] for name in split.cameras]
    return float(np.median([np.linalg.norm(c.position - centre) / c.fl_x for c in cameras]))


def see(posed: Posed, part: Rectangle) -> tuple[mi.Color3f, mi.Float, Hits]:
    """What the pixels of a rectangle see of primitives: premultiplied sRGB colour and opacity, attached; and
    the primitives met."""
    origin, direction = (kind(np.asarray(values, np.float32))
                         for kind, values in zip((mi.Point3f, mi.Vector3f), part.rays(), strict=True))
    dr.eval(posed)
    hits = find_hits(posed, [part], origin, direction)
    return *composite(posed, hits, origin, direction), hits


class ViewObjective:
    """The loss of one view of the training split: mean squared error in sRGB over the rectangle around the
    body, or rows of it, and the mask's term.

    Args:
        capture: the images.
        splats: what is trained.
        binding: its primitives.
        settings: of the loss.

    Attributes:
        splats: what is trained.
        binding: its primitives; may be replaced.
        offset: the offsets of the last step, whose gradients say where primitives are missing.

    Raises:
        InputError: the capture has no training images, or a training camera does not see the body.
    """

    def __init__(self, capture: Capture, splats: Splats, binding: Binding, settings: Settings) -> None:
        self._views = TrainingViews(capture, 0, margin=MARGIN, masks=True)
        self._split = capture.splits["train"]
        self.splats, self.binding = splats, binding
        self._weight, self._noise = settings.opacity_weight, settings.pose_noise
        self._background = mi.Color3f(capture.background.tolist())
        dr.make_opaque(self._background)
        self.offset = mi.Float()

    def mean_colour(self) -> np.ndarray:
        """(3,) sRGB of the performer."""
        return self._views.mean_colour()

    def __call__(self, parameters: Mapping[str, mi.Float], rng: np.random.Generator) -> Outcome:
        """The loss of a random view."""
        frame = self._split.frames[int(rng.integers(len(self._split.frames)))]
        camera, (x, y, width, height), image = self._views.view(
            int(rng.integers(len(self._split.cameras))), frame)
        count = min(max(PIXELS // width, 1), height)
        first = int(rng.integers(height - count + 1))
        image = image[first : first + count].reshape(-1, 3)
        covered = self._views.coverage(camera, frame)[first : first + count].reshape(-1, 2)
        self.offset = parameters["offset"]
        noise = rng.normal(0, self._noise, self.splats.rig.poses.pose.shape[1:])
        colour, opacity, _ = see(self.splats.at(self.binding, parameters, frame, noise),
                                 Rectangle(camera, x, y + first, width, count))
        difference = colour + (1.0 - opacity) * self._background - mi.Color3f(image.T)
        error = dr.mean(dr.squared_norm(difference)) / 3.0
        mask, valid = (mi.Float(values) for values in covered.T)
        loss = error + self._weight * dr.mean(valid * dr.square(opacity - mask))
        return Outcome(loss, dr.detach(error))


class SplatOptimisation(Optimisation):
    """A training of primitives, which are removed and split on the way.

    Args:
        objective: the loss; its binding changes with the primitives.
        settings: when and how.
        seconds, seed, spent: as for `Optimisation`.

    Attributes:
        rounds: how often primitives were removed and split.
    """

    def __init__(self, objective: ViewObjective, settings: Settings, seconds: float | None = None,
                 seed: int = 0, spent: float = 0.0) -> None:
        rng = np.random.default_rng([seed, 3])
        learned = initial(len(objective.binding), objective.mean_colour(), rng)
        shared = {NETWORK: objective.splats.network.initial(rng), SHADE: np.zeros(LIGHT, np.float32)}
        super().__init__({name: values.ravel() for name, values in learned.items()} | shared, objective,
                         settings.schedule, seconds, seed, RATES, spent)
        self._views, self._settings = objective, settings
        self._split_rng = np.random.default_rng([seed, 2])
        self.rounds = 0
        self._clear()

    @property
    def binding(self) -> Binding:
        """Where the primitives are bound to now."""
        return self._views.binding

    @property
    def learned(self) -> Arrays:
        """What is learned now, (k, N) by name."""
        return {name: self.parameters[name].numpy().reshape(size, -1) for name, size in LEARNED.items()}

    def step(self) -> None:
        """As `Optimisation.step`; then, if it is time, removes and splits primitives."""
        super().step()
        force = np.linalg.norm(dr.grad(self._views.offset).numpy().reshape(3, -1), axis=0)
        force[~np.isfinite(force)] = 0
        self._force += force
        self._steps_seen += force > 0
        settings = self._settings
        if self.rounds + 1 <= settings.rounds * min(self.done / settings.densified, 1):
            self.rounds += 1
            self._densify(settings)

    def tensors(self) -> dict[str, np.ndarray]:
        """As `Optimisation.tensors`, with what the next round needs."""
        return {**super().tensors(), "force": self._force, "steps_seen": self._steps_seen}

    def metadata(self) -> dict[str, Any]:
        """As `Optimisation.metadata`, with the rounds."""
        return {**super().metadata(), "rounds": self.rounds,
                "random_of_rounds": self._split_rng.bit_generator.state}

    def restore(self, tensors: dict[str, np.ndarray], metadata: Mapping[str, Any], where: str) -> None:
        """As `Optimisation.restore`."""
        super().restore(tensors, metadata, where)
        try:
            self.rounds = int(metadata["rounds"])
            self._force, self._steps_seen = tensors["force"], tensors["steps_seen"]
            self._split_rng.bit_generator.state = metadata["random_of_rounds"]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(where, f"metadata that is not a training state's ({error})",
                             "what a checkpoint writes") from None

    def _densify(self, settings: Settings) -> None:
        score = self._force / np.maximum(self._steps_seen, 1)
        more = -(-(self._views.splats.wanted - len(score)) // (settings.rounds + 1 - self.rounds))
        found = densify(self._views.binding, self.learned, score, more, self._split_rng)
        self._views.binding = found.binding
        self.exchange({name: values.ravel() for name, values in found.learned.items()})
        self._clear()

    def _clear(self) -> None:
        self._force = np.zeros(len(self._views.binding))
        self._steps_seen = np.zeros(len(self._views.binding))
