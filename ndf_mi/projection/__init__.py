"""P_θ: from a point near the posed body to its texture coordinates and signed distance."""

from __future__ import annotations

from ndf_mi.projection.bands import Bands
from ndf_mi.projection.posed import PosedSurface, Projection
from ndf_mi.projection.surface import Surface, aligned

__all__ = ["Bands", "PosedSurface", "Projection", "Surface", "aligned"]
