"""What the comparison of projections notices: gradients of the distance that are wrong on and next to the surface; wrong texels."""

from __future__ import annotations

import numpy as np
import pytest

from ndf_mi.projection import PosedSurface
from ndf_mi.stability.geometry import ball, box
from ndf_mi.stability.projections import judge

RNG = np.random.default_rng(0)


def points(kind: str) -> tuple:
    """A shape, and points on its faces, a hair off them, on its corners, and a hair off these."""
    if kind.startswith("face"):
        off = 1e-7 if kind == "face, off" else 0.0
        return box((2, 2, 1), (0, 0, -0.5)), np.concatenate([RNG.uniform(-0.9, 0.9, (20, 2)), np.full((20, 1), off)], 1)
    shape = ball()
    return shape, shape.vertices * (1 + 3e-6 if kind == "corner, off" else 1)


@pytest.mark.parametrize("kind", ["face", "face, off", "corner", "corner, off"])
def test_wrong_slopes_are_noticed(kind, monkeypatch):
    shape, at = points(kind)
    sign = np.zeros(len(at), int)
    right = judge("", shape, at, 0.2, sign, smooth=False)
    assert right.gradient <= 1e-5
    once = PosedSurface._sign
    for factor in (1e-6, -1.0):
        def wrong(self, *arguments, factor=factor):
            normal, l, slope = once(self, *arguments)
            return normal, l, slope * factor

        monkeypatch.setattr(PosedSurface, "_sign", wrong)
        assert judge("", shape, at, 0.2, sign, smooth=False).gradient > 1e-5


def test_texels_of_another_chart_are_noticed(monkeypatch):
    shape, at = points("corner")
    once = PosedSurface.project

    def wrong(self, x, active=True):
        found = once(self, x, active)
        found.uv = found.uv + 0.01
        return found

    monkeypatch.setattr(PosedSurface, "project", wrong)
    assert judge("", shape, at, 0.2, np.zeros(len(at), int), smooth=False).primal > 1e-3
