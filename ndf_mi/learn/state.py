"""The optimiser's state as tensors, so that training goes on exactly where it stopped."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from ndf_mi import files
from ndf_mi.errors import InputError


def adam_tensors(optimiser: Any, prefix: str) -> dict[str, np.ndarray]:
    """Values, moments and step count of a ``mi.ad.Adam``, named ``PREFIX.KEY.value|m|v|t``."""
    out: dict[str, np.ndarray] = {}
    for key, (value, _, _, (t, m, v, _)) in optimiser.state.items():
        name = f"{prefix}.{key}"
        out |= {f"{name}.value": value.numpy(), f"{name}.m": m.numpy(), f"{name}.v": v.numpy()}
        out[f"{name}.t"] = np.array([int(t[0])], dtype=np.int64)
    return out


def restore_adam(optimiser: Any, prefix: str, tensors: dict[str, np.ndarray], where: str) -> None:
    """The inverse of :func:`adam_tensors` on an optimiser that holds the same keys.

    Raises:
        InputError: a tensor is missing or of another size.
    """
    for key in list(optimiser.state):
        value, promoted, rate, (t, m, v, extra) = optimiser.state[key]
        name = f"{prefix}.{key}"
        for part in ("value", "m", "v", "t"):
            found = tensors.get(f"{name}.{part}")
            expected = 1 if part == "t" else value.shape[0]
            if found is None or found.size != expected:
                raise InputError(f"{where}: {name}.{part}", "nothing" if found is None else f"{found.size} numbers", f"{expected}")
        optimiser[key] = type(value)(tensors[f"{name}.value"])
        kept = optimiser.state[key][0]
        optimiser.state[key] = (kept, promoted, rate, (type(t)(int(tensors[f"{name}.t"][0])), type(m)(tensors[f"{name}.m"]),
                                                       type(v)(tensors[f"{name}.v"]), extra))


def write_state(path: str | os.PathLike[str], tensors: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
    """Writes tensors and JSON-ready facts (step, random state, …) in one safetensors file, whole or not at all."""
    with files.replacing(path) as beside:
        save_file(tensors, beside, metadata={"facts": json.dumps(facts)})


def read_state(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The inverse of :func:`write_state`.

    Raises:
        InputError: the file is missing or cannot be read.
    """
    try:
        with safe_open(Path(path), framework="numpy") as archive:
            facts = json.loads((archive.metadata() or {})["facts"])
            return {name: archive.get_tensor(name) for name in archive.keys()}, facts  # noqa: SIM118 - not a dict
    except FileNotFoundError:
        raise InputError(path, "no such file", "the training state to go on from") from None
    except (SafetensorError, OSError, ValueError, KeyError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a training state") from None


