"""Parametric bodies, their poses, skinning in Dr.Jit, motions to play on them, and texture atlases."""

from __future__ import annotations

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses

__all__ = ["Body", "Poses"]
