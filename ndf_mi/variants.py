"""Mitsuba's variants: which one suits this machine, and setting it. No other module names a backend.

The functions import Mitsuba and Dr.Jit themselves: this module can be imported where those are broken.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

from ndf_mi import llvm
from ndf_mi.errors import InputError

LLVM = "llvm_ad_rgb"
CUDA = "cuda_ad_rgb"
SUPPORTED = (LLVM, CUDA)
VARIABLE = "NDF_MI_VARIANT"
NEEDED = f"LLVM {llvm.MINIMUM} or newer"


def cuda_usable() -> bool:
    """Whether Dr.Jit has found NVIDIA's driver and a GPU."""
    dr = _working("drjit")
    return bool(dr.has_backend(dr.JitBackend.CUDA))


def llvm_usable() -> bool:
    """Whether Dr.Jit has loaded an LLVM. Importing ``ndf_mi`` has made sure that it is one that works."""
    dr = _working("drjit")
    return bool(dr.has_backend(dr.JitBackend.LLVM))


def fused_width() -> int:
    """Width of networks up to which cooperative vectors are faster than matrix products over all samples.

    Measured on the CPU, where nothing is differentiated. 0 on GPUs, which only have them in half precision.
    """
    mi = _working("mitsuba")
    return 64 if mi.variant() == LLVM else 0


def cooperative_precisions() -> tuple[str, ...]:
    """The precisions of cooperative vectors here: `single` and `half` on the CPU, `half` on GPUs."""
    mi = _working("mitsuba")
    return ("single", "half") if mi.variant() == LLVM else ("half",)


def preferred() -> str:
    """The variant for this machine: CUDA where a GPU is usable, else LLVM. ``NDF_MI_VARIANT`` overrides.

    Raises:
        InputError: the variable names an unsupported variant, no backend is usable, or Dr.Jit cannot be
            imported.
    """
    asked = os.environ.get(VARIABLE)
    if asked:
        return _checked(asked, f"the environment variable {VARIABLE}")
    if cuda_usable():
        return CUDA
    if llvm_usable():
        return LLVM
    raise _nothing_usable()


def use(name: str | None = None) -> str:
    """Sets the variant unless one is already set; returns the active one.

    On one core it gives Dr.Jit's thread pool a second thread: with one, Mitsuba waits forever when it reads
    or writes EXR files.

    Args:
        name: the variant to set; None keeps the active one, or takes :func:`preferred`.

    Raises:
        InputError: the variant is unsupported or does not work here, another one is already active, or
            Mitsuba cannot be imported.
    """
    mi = _working("mitsuba")
    active = mi.variant()
    if active is not None and name in (None, active):
        return active
    if active is not None:
        raise InputError("variant", f"{active}, already active", f"{name}", "A process can have one variant.")
    chosen = preferred() if name is None else _checked(name, "variant")
    mi.set_variant(chosen)
    dr = _working("drjit")
    if dr.thread_count() < 2:
        dr.set_thread_count(2)
    return chosen


def _checked(name: str, where: str) -> str:
    if name not in SUPPORTED:
        raise InputError(where, repr(name), " or ".join(SUPPORTED))
    if name == LLVM and not llvm_usable():
        raise InputError(where, f"{LLVM} without a usable LLVM", NEEDED, llvm.install_command())
    if name == CUDA and not cuda_usable():
        raise InputError(
            where, f"{CUDA} without a usable NVIDIA GPU", LLVM, f"unset {VARIABLE}, or install the driver"
        )
    return name


def _working(package: str) -> Any:
    try:
        return importlib.import_module(package)
    except (ImportError, NameError) as error:  # Dr.Jit raises NameError where a system library is missing
        cause = error.__context__ or error
        raise InputError(
            package, f"{cause}", "a package that can be imported", "Run `ndf-mi doctor`."
        ) from error


def _nothing_usable() -> InputError:
    return InputError(
        "this machine", "neither a usable LLVM nor an NVIDIA GPU", NEEDED, llvm.install_command()
    )
