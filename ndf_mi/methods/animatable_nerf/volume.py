"""Animatable NeRF as a volume: its parameters, and the field at any frame of the capture."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping

import drjit as dr
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.methods.animatable_nerf.architecture import Architecture
from ndf_mi.methods.animatable_nerf.field import Canonical, Performer, Pose, PosedNerf
from ndf_mi.methods.animatable_nerf.networks import BlendNetwork, CanonicalField, Codes
from ndf_mi.methods.volume.volume import Parameters

CACHED_POSES = 64


class AnimatableNerfVolume:
    """The networks of an architecture around the performer of a capture.

    Parameters, all flat: `blend`, the network that corrects blend weights, and `blend_codes`, a code for the
    canonical space and one for each training frame; `canonical`, the canonical NeRF, `grid`, its hash table
    if it has one, and `colour_codes`, one for each training frame; `novel` and `novel_codes`, another network
    of blend weights with a code for each frame of the capture that training does not see.

    Args:
        capture: its body and poses are those of the surface to build on.
        shape: the architecture.

    Attributes:
        poses: the capture's.
        rates: factors on learning rates.
        performer: the body.
        trained, untrained: the frames of the training split, and all others.

    Raises:
        InputError: the body has no skinning model, or the training split has no frames.
    """

    def __init__(self, capture: Capture, shape: Architecture) -> None:
        self.poses = capture.poses
        self.shape = shape
        self.performer = Performer(capture, shape.reach)
        self.trained = list(capture.splits["train"].frames)
        if not self.trained:
            raise InputError(f"{capture.path / 'capture.json'}: splits.train", "no frames", "at least one")
        seen = set(self.trained)
        self.untrained = [int(frame) for frame in capture.poses.frames if int(frame) not in seen]
        self.rates: Mapping[str, float] = {"grid": shape.grid_rate}
        self._field = CanonicalField(shape)
        self._blend = BlendNetwork(shape, self.performer.joints)
        self._blend_codes = Codes(1 + len(self.trained), shape.blend_latent)
        self._colour_codes = Codes(len(self.trained), shape.colour_latent)
        self._novel_codes = Codes(len(self.untrained), shape.blend_latent)
        self._kept: OrderedDict[int, Pose] = OrderedDict()

    def initial(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """What is trained on images, untrained."""
        field = self._field.initial_parameters(int(rng.integers(2**31)))
        found = {"blend": self._blend.initial(rng), "blend_codes": self._blend_codes.initial(rng),
                 "canonical": field.weights.numpy(), "colour_codes": self._colour_codes.initial(rng)}
        return found if field.grid is None else {**found, "grid": field.grid.numpy()}

    def initial_novel(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """What is trained without images, untrained."""
        return {"novel": self._blend.initial(rng), "novel_codes": self._novel_codes.initial(rng)}

    def at(self, frame: int, parameters: Parameters) -> PosedNerf:
        """The field at a frame, attached to the parameters. A frame without images has the colours of the
        last training frame, and its own blend weights, from `novel`.

        Raises:
            InputError: there is no such frame.
        """
        pose = self.pose(frame)
        attached = any(dr.grad_enabled(value) for value in parameters.values())
        if frame in self.trained:
            row = self.trained.index(frame)
            code = self._blend_codes(parameters["blend_codes"], 1 + row)
            blend = self._blend.bind(code, parameters["blend"])
        else:
            row = len(self.trained) - 1
            code = self._novel_codes(parameters["novel_codes"], self.untrained.index(frame))
            blend = self._blend.bind(code, parameters["novel"])
        return PosedNerf(self.canonical(parameters, row), pose, blend, attached)

    def canonical(self, parameters: Parameters, row: int) -> Canonical:
        """The canonical space with the colours of a training frame, by its index."""
        code = self._colour_codes(parameters["colour_codes"], row)
        field = self._field.bind(code, FieldParameters(parameters["canonical"], parameters.get("grid")))
        rest = self._blend_codes(parameters["blend_codes"], 0)
        return Canonical(self.shape, self.performer, field, self._blend.bind(rest, parameters["blend"]))

    def pose(self, frame: int) -> Pose:
        """The body at a frame; the last few are kept. Raises InputError if there is no such frame."""
        if frame not in self._kept:
            self._kept[frame] = self.performer.pose(frame)
            if len(self._kept) > CACHED_POSES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(frame)
        return self._kept[frame]
