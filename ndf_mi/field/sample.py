"""What a field is at points: the interface between fields and renderers."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi


@dataclass
class FieldSample:
    """A field at K points. `sigma` in 1/m, `colour` linear; `u` is (u*, v*) and the signed distance l in metres; `normal` unit;
    `weight` how many samples each stands for, where some were left out at random, else None."""

    sigma: mi.Float
    colour: mi.Color3f
    u: mi.Point3f
    normal: mi.Normal3f
    weight: mi.Float | None = None
