"""Parametric bodies, their poses, skinning in Dr.Jit, and motion to play on them."""

from __future__ import annotations

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses

__all__ = ["Body", "Poses"]
