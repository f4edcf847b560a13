"""What the pose changes of primitives: a network for offsets and colours."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.encoding import frequency, frequency_width
from ndf_mi.field.engines import Batched
from ndf_mi.field.layers import initial_weights
from ndf_mi.methods.volume.volume import layer_tensors, stack_layers

OCTAVES = 5
"""Of the encoding of a primitive's place at rest, in metres: the shortest wavelength is 0.4 m."""

POSE_FEATURES, WIDTH = 8, 32
"""Numbers that the network sees of the pose, and width of its two hidden layers."""

OUTPUTS = 6


class PoseNetwork:
    """Offset and colour of each primitive, from its place on the body at rest, features of its own, the
    surface's normal in world space and a few features of the pose.

    Args:
        joints: of the body. The root's rotation is not seen.
        features: numbers of each primitive's own.
    """

    def __init__(self, joints: int, features: int) -> None:
        inputs = frequency_width(3, OCTAVES) + features + 3 + POSE_FEATURES
        self._layers = stack_layers([
            ("pose", max(3 * (joints - 1), 1), POSE_FEATURES), ("first", inputs, WIDTH),
            ("second", WIDTH, WIDTH), ("out", WIDTH, OUTPUTS)])

    def initial(self, rng: np.random.Generator) -> np.ndarray:
        """Flat float32 weights. Offsets and colours are almost zero at first."""
        weights = initial_weights(self._layers, rng)
        weights[self._layers["out"].offset :] *= 0.01
        return weights

    def __call__(self, weights: mi.Float, place: mi.Point3f, features: Sequence[mi.Float],
                 normal: mi.Vector3f, pose: np.ndarray) -> tuple[mi.Vector3f, mi.Color3f]:
        """Offsets, in the frame of reference, and what is added to the colours; attached.

        Args:
            weights: flat.
            place: N places at rest, metres.
            features: (N) each.
            normal: of N primitives, world space.
            pose: (J, 3) axis-angles.
        """
        count = dr.width(place)
        tensors = layer_tensors(weights, self._layers)
        angles = np.append(pose[1:].ravel(), 0)[: max(pose[1:].size, 1)].astype(np.float32)
        matrix, bias = tensors["pose"]
        seen = dr.tanh(matrix @ mi.TensorXf(angles[:, None]) + bias).array
        engine = Batched(tensors, count)
        x = engine.enter(frequency(list(place), OCTAVES), list(features), list(normal),
                         [dr.gather(mi.Float, seen, mi.UInt32(row)) for row in range(POSE_FEATURES)])
        for name in ("first", "second"):
            x = engine.enter(dr.maximum(engine.linear(name, x), 0.0))
        rows = engine.rows(engine.linear("out", x))
        return mi.Vector3f(*rows[:3]), mi.Color3f(*rows[3:])
