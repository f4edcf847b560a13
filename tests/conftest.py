"""Sets the variant once for all tests: ``NDF_MI_VARIANT``, or what suits the machine."""

from __future__ import annotations

from ndf_mi import variants

variants.use()
