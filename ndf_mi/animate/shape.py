"""Shape coefficients from the command line: by name, or as numbers in order."""

from __future__ import annotations

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.errors import InputError

_WHERE = "--shape"


def parse_shape(text: str, body: Body, performer: np.ndarray | None) -> np.ndarray:
    """The performer's shape coefficients, (B,) float32, with some replaced.

    Args:
        text: ``height=0.3,weight=-0.5`` for the named coefficients, or ``0.3,-0.5`` for the first ones.
        body: the run's body.
        performer: (B,) the performer's own; zeros if None.

    Raises:
        InputError: the body has no skinning model or shape coefficients, a name is unknown, there are too
            many numbers, or one is not finite.
    """
    if not body.skinned or body.shape_count == 0:
        missing = "skinning model" if not body.skinned else "shape coefficients"
        raise InputError(_WHERE, f"a run whose body has no {missing}",
                         "a body with a skinning model and shape coefficients")
    names = body.shape_names or ()
    shape = np.zeros(body.shape_count, np.float32) if performer is None else np.array(performer, np.float32)
    parts = [part.strip() for part in text.split(",")]
    named = ["=" in part for part in parts]
    if any(named) and not all(named):
        raise InputError(_WHERE, repr(text), "NAME=NUMBER for all or numbers for all")
    if len(parts) > body.shape_count:
        raise InputError(_WHERE, f"{len(parts)} coefficients",
                         f"at most {body.shape_count}, the number that the body has")
    for i, part in enumerate(parts):
        name, _, value = part.rpartition("=")
        name = name.strip()
        if named[0] and name not in names:
            expected = ", ".join(names) if names else "numbers: the body's coefficients have no names"
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
