"""Evaluates a volume in chunks of samples, so that images need bounded memory."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.render.ray_samples import VolumeField

CHUNK = 1 << 15
"""Samples evaluated at once. Hidden layers of width 256 take 32 MiB each then."""


class Chunked:
    """A volume field whose networks see at most `CHUNK` samples at once; detached. Otherwise as `volume`."""

    def __init__(self, volume: VolumeField) -> None:
        self._volume = volume
        self.bbox = volume.bbox
        self.sample_factor = volume.sample_factor

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """As the volume's."""
        return self._volume.may_contain(x)

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """As the volume's."""
        return self._volume.locate(x, active)

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """As the volume's."""
        return self.evaluate(x, mi.Vector3f(0, 0, 1), located, active).sigma

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """As the volume's, chunk by chunk."""
        width = dr.width(active)
        if width <= CHUNK:
            return self._volume.evaluate(x, d, located, active)
        d = d + dr.zeros(mi.Vector3f, width)
        out = dr.zeros(FieldSample, width)
        with dr.suspend_grad():
            dr.eval(x, d, located, active)
            for start in range(0, width, CHUNK):
                lane = dr.arange(mi.UInt32, CHUNK) + dr.opaque(mi.UInt32, start)
                inside = lane < width
                source = dr.minimum(lane, width - 1)
                found = self._volume.evaluate(
                    dr.gather(mi.Point3f, x, source), dr.gather(mi.Vector3f, d, source),
                    dr.gather(Located, located, source), dr.gather(mi.Bool, active, source) & inside)
                plain = FieldSample(found.sigma, found.colour, found.u, found.normal, found.band)
                dr.scatter(out, plain, lane, inside, mode=dr.ReduceMode.Permute)
                dr.eval(out)
        return out
