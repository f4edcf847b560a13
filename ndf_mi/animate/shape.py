"""Shape coefficients as a user writes them: by name, or as numbers in their order."""

from __future__ import annotations

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.errors import InputError

_WHERE = "--shape"


def parse_shape(text: str, body: Body, performer: np.ndarray | None) -> np.ndarray:
    """``height=0.3,weight=-0.5`` or ``0.3,-0.5`` as (B,) float32 coefficients: those named, or the first ones, are replaced in the
    performer's own (zeros where they are not known).

    Raises:
        InputError: a body without a model or without shape coefficients, an unknown name, too many numbers, or no finite number.
    """
    if not body.skinned or body.shape_count == 0:
        missing = "skinning model" if not body.skinned else "shape coefficients"
        raise InputError(_WHERE, f"a run whose body has no {missing}", "a body with both, to be reshaped by")
    names = body.shape_names or ()
    shape = np.zeros(body.shape_count, np.float32) if performer is None else np.array(performer, np.float32)
    parts = [part.strip() for part in text.split(",")]
    named = ["=" in part for part in parts]
    if any(named) and not all(named):
        raise InputError(_WHERE, repr(text), "either NAME=NUMBER throughout or numbers alone")
    if len(parts) > body.shape_count:
        raise InputError(_WHERE, f"{len(parts)} coefficients", f"at most {body.shape_count}, as the body has")
    for i, part in enumerate(parts):
        name, _, value = part.rpartition("=")
        name = name.strip()
        if named[0] and name not in names:
            expected = f"one of {', '.join(names)}" if names else "numbers alone, since the body names no coefficient"
            raise InputError(_WHERE, f"the name {name!r}", expected)
        shape[names.index(name) if named[0] else i] = _number(value, text)
    return shape


def _number(value: str, text: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(_WHERE, f"{value.strip()!r} in {text!r}", "a finite number")
    return number
