"""Neural deformable fields of moving people, as Mitsuba 3 participating media.

Importing this package points Dr.Jit to an LLVM that works, imports Mitsuba, and registers the plugins of
:mod:`ndf_mi.plugins` for the active variant and for every variant that is set later.
"""

from __future__ import annotations

import importlib

from ndf_mi import llvm

llvm.ensure_llvm()

__version__ = "0.2.0.dev0"


def register() -> None:
    """Registers the plugins ``ndf``, ``ndf_shell``, … for the active variant. May be called repeatedly.

    Importing the package calls it, and so does setting one of :data:`ndf_mi.variants.SUPPORTED`.

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
except (ImportError, NameError):  # Dr.Jit raises NameError where a system library is missing
    pass  # `ndf-mi doctor` must run without Mitsuba; the modules that need it fail when they import it
else:
    mi.detail.add_variant_callback(_on_variant)
    _on_variant(None, mi.variant())
