"""Blend weights at frames without images, from their agreement with the canonical ones alone.

The canonical space stays as it was trained. A new network, with a code for each frame, learns blend weights
at the new poses: points around the posed body are unposed, points around the body at rest are posed, and the
weights that both spaces give them must agree. It uses poses, but no image.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.sample import Located
from ndf_mi.methods.animatable_nerf.field import PosedNerf, mean_disagreement
from ndf_mi.methods.animatable_nerf.skinning import Blended, smooth_l1
from ndf_mi.methods.animatable_nerf.volume import AnimatableNerfVolume
from ndf_mi.methods.volume.optimisation import Objective, Outcome
from ndf_mi.methods.volume.volume import Parameters
from ndf_mi.render.sampling import compact


class NovelPoses:
    """The stage of training that learns a volume's `untrained` frames: a `FinalStage`.

    Args:
        volume: with at least one such frame.

    Attributes:
        share, schedule, note: see `FinalStage`.
    """

    def __init__(self, volume: AnimatableNerfVolume) -> None:
        shape, count = volume.shape, len(volume.untrained)
        self._volume = volume
        self.share, self.schedule = shape.novel_share, shape.novel
        self.note = (f"Blend weights at the {count} frames without images were learnt last, from their poses "
                     "alone.")

    def initial(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Network and codes, untrained."""
        return self._volume.initial_novel(rng)

    def objective(self, parameters: Parameters) -> Objective:
        """The disagreement of blend weights at one frame, drawn at random: the mean of points around the
        posed body, plus that of points around the body at rest."""
        volume, points = self._volume, self._volume.shape.novel_points
        frozen = {name: dr.detach(value) for name, value in parameters.items()}

        def disagreement(novel: Parameters, rng: np.random.Generator) -> Outcome:
            frame = volume.untrained[int(rng.integers(len(volume.untrained)))]
            posed = volume.at(frame, {**frozen, **novel})
            around, rest = (mi.Point3f(rng.random((3, points), dtype=np.float32)) for _ in range(2))
            loss = from_world(posed, around) + from_rest(posed, rest)
            return Outcome(loss, dr.detach(loss))

        return disagreement


def from_world(posed: PosedNerf, unit: mi.Point3f) -> mi.Float:
    """The mean disagreement at points around the posed body and at the places that they are unposed to.

    Args:
        unit: points of the unit cube, which is stretched to the body's box.
    """
    with dr.suspend_grad():
        x = _in_box(posed.bbox, unit)
        lane, real, _ = compact(posed.may_contain(x))
        x = dr.gather(mi.Point3f, x, lane)
        dr.eval(x)
        located = posed.locate(x, real)
        lane, real, _ = compact(located.valid & real)
        x, located = dr.gather(mi.Point3f, x, lane), dr.gather(Located, located, lane)
    weights = posed.weights(x, located, real)
    place, inside = posed.unposed(x, weights, real)
    canonical, inside = posed.canonical.weights(place, inside)
    return mean_disagreement(smooth_l1(weights, canonical), posed.canonical.dense(place, inside))


def from_rest(posed: PosedNerf, unit: mi.Point3f) -> mi.Float:
    """The mean disagreement at points around the body at rest and at the places that they are posed to, if
    these are within reach of the posed body. Arguments as for :func:`from_world`."""
    canonical = posed.canonical
    with dr.suspend_grad():
        place = _in_box(canonical.body.rest.bbox, unit)
        lane, real, _ = compact(canonical.body.rest.may_contain(place))
        place = dr.gather(mi.Point3f, place, lane)
        lane, real, _ = compact(canonical.dense(place, canonical.contains(place, real)))
        place = dr.gather(mi.Point3f, place, lane)
        weights, real = canonical.weights(place, real)
        x = Blended(posed.pose.transforms, weights).forward(place)
        dr.eval(x, weights, real)
        located = posed.locate(x, real)
        real &= located.valid
    return mean_disagreement(smooth_l1(posed.weights(x, located, real), weights), real)


def _in_box(box: mi.BoundingBox3f, unit: mi.Point3f) -> mi.Point3f:
    low, high = mi.Point3f(box.min), mi.Point3f(box.max)
    # The box changes with the pose: a literal would be compiled into the kernel.
    dr.make_opaque(low, high)
    return low + unit * (high - low)
