"""The smallest volume: a ball around the middle of the body whose density and colours are found."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.box import padded_box
from ndf_mi.colour import srgb_to_linear
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.methods.volume.method import VolumeMethod, VolumePreset
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.rays import RaySettings


@dataclass(frozen=True)
class Ball:
    """Radius in metres of the ball that may be dense."""

    radius: float = 0.5


class PosedBall:
    """σ = exp(a) inside; the colour is linear in the direction from the middle."""

    sample_factor = 1

    def __init__(self, vertices, radius, parameters):
        low, high = padded_box(vertices)
        self.bbox = mi.BoundingBox3f(mi.ScalarPoint3f(*low), mi.ScalarPoint3f(*high))
        middle = 0.5 * (vertices.min(0) + vertices.max(0))
        self.middle = mi.Point3f(*map(float, middle))
        dr.make_opaque(self.middle)
        self.radius, self.parameters = radius, parameters

    def may_contain(self, x):
        return dr.squared_norm(x - self.middle) < self.radius**2

    def locate(self, x, active):
        return Located.anywhere(active & self.may_contain(x))

    def density(self, x, located, active):
        return dr.detach(self.evaluate(x, mi.Vector3f(0, 0, 1), located, active).sigma)

    def evaluate(self, x, d, located, active):
        way = dr.select(active, (x - self.middle) / self.radius, mi.Vector3f(0))
        a, c = self.parameters["density"], self.parameters["colour"]
        sigma = dr.exp(dr.gather(mi.Float, a, mi.UInt32(0))) + 0 * way.x
        rgb = []
        for channel in range(3):
            k = [dr.gather(mi.Float, c, mi.UInt32(4 * channel + i)) for i in range(4)]
            value = k[0] + k[1] * way.x + k[2] * way.y + k[3] * way.z
            rgb.append(dr.rcp(1 + dr.exp(-value)))
        return FieldSample(sigma, srgb_to_linear(mi.Color3f(*rgb)), mi.Point3f(0), mi.Normal3f(0))

    def penalty(self, radiance):
        return 1e-6 * dr.mean(radiance.samples.sigma)


class BallVolume:
    rates = {"density": 3.0}

    def __init__(self, capture, ball):
        self.poses, self._ball = capture.poses, ball

    def initial(self, rng):
        return {"density": np.full(1, 1.0, np.float32),
                "colour": rng.normal(0, 0.1, 12).astype(np.float32)}

    def at(self, frame, parameters):
        return PosedBall(self.poses.vertices[self.poses.index(frame)], self._ball.radius, parameters)


class BallMethod(VolumeMethod):
    key, label = "ball", "Ball"
    presets = {
        "fast": VolumePreset(Ball(), Schedule(40, 0.1), RaySettings(rays=256, samples=24,
                                                                    min_transmittance=1e-3)),
        "offset": VolumePreset(Ball(), Schedule(2, 0.1), RaySettings(rays=64, samples=8), surface="offset"),
    }

    def volume(self, capture, architecture):
        return BallVolume(capture, architecture)
