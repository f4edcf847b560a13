"""A volume evaluated in chunks equals the volume evaluated at once."""

import mitsuba as mi
import numpy as np
from tiny_volume import PosedBall

from ndf_mi.field.sample import Located
from ndf_mi.methods.volume import chunks
from ndf_mi.methods.volume.chunks import Chunked


def test_chunks_equal_the_whole(monkeypatch):
    monkeypatch.setattr(chunks, "CHUNK", 64)
    vertices = np.array([[-1, -1, -1], [1, 1, 1]], np.float32)
    parameters = {"density": mi.Float(2.0), "colour": mi.Float(np.linspace(-1, 1, 12))}
    ball, rng = PosedBall(vertices, 0.9, parameters), np.random.default_rng(0)
    for count in (10, 64, 150):
        x, d = mi.Point3f(rng.normal(0, 0.5, (3, count))), mi.Vector3f(rng.normal(0, 1, (3, count)))
        active = mi.Bool(rng.random(count) < 0.8)
        whole = ball.evaluate(x, d, Located.anywhere(active), active)
        parts = Chunked(ball).evaluate(x, d, Located.anywhere(active), active)
        np.testing.assert_allclose(parts.sigma, whole.sigma, rtol=1e-6)
        np.testing.assert_allclose(parts.colour, whole.colour, rtol=1e-5)
        np.testing.assert_allclose(Chunked(ball).density(x, Located.anywhere(active), active), whole.sigma,
                                   rtol=1e-6)
