"""Neural deformable fields of moving people, as Mitsuba 3 participating media.

Importing this package points Dr.Jit at an LLVM that works, imports Mitsuba and registers the plugins of
:mod:`ndf_mi.plugins` for the active variant and for every variant that is set later.
"""

from __future__ import annotations

import importlib

from ndf_mi import llvm

llvm.ensure_llvm()

__version__ = "0.1.0"


def register() -> None:
    """Registers Mitsuba's plugins ``ndf``, ``ndf_shell``, … for the active variant; again is harmless.

    Done by itself on import, and whenever one of :data:`ndf_mi.variants.SUPPORTED` is set.

    Raises:
        ImportError: no variant is set.
    """
    importlib.import_module("ndf_mi.plugins").register()


def _on_variant(_old: str | None, new: str | None) -> None:
    from ndf_mi import variants

    if new in variants.SUPPORTED:
        register()


try:
    import mitsuba as mi  # after ensure_llvm: Dr.Jit loads LLVM as soon as it is imported
except (ImportError, NameError):  # NameError is what Dr.Jit makes of a missing system library
    pass  # `ndf-mi doctor` must run without it; every module that needs it imports it itself, and fails there
else:
    mi.detail.add_variant_callback(_on_variant)
    _on_variant(None, mi.variant())
