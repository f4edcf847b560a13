"""Optimiser state on disk, complete enough to continue a training exactly."""

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

_METADATA = "facts"  # the key in files on disk


def adam_tensors(optimiser: Any, prefix: str) -> dict[str, np.ndarray]:
    """Values, moments and step count of a ``mi.ad.Adam``, named ``PREFIX.KEY.value|m|v|t``."""
    tensors: dict[str, np.ndarray] = {}
    for key, (value, _, _, (t, m, v, _)) in optimiser.state.items():
        name = f"{prefix}.{key}"
        tensors |= {f"{name}.value": value.numpy(), f"{name}.m": m.numpy(), f"{name}.v": v.numpy()}
        tensors[f"{name}.t"] = np.array([int(t[0])], dtype=np.int64)
    return tensors


def restore_adam(optimiser: Any, prefix: str, tensors: dict[str, np.ndarray], where: str) -> None:
    """Sets an optimiser that holds the same keys to what :func:`adam_tensors` returned.

    Raises:
        InputError: a tensor is missing or has another size.
    """
    for key in list(optimiser.state):
        value, promoted, rate, (t, m, v, extra) = optimiser.state[key]
        name = f"{prefix}.{key}"
        for part in ("value", "m", "v", "t"):
            found = tensors.get(f"{name}.{part}")
            expected = 1 if part == "t" else value.shape[0]
            if found is None or found.size != expected:
                raise InputError(f"{where}: {name}.{part}",
                                 "nothing" if found is None else f"{found.size} numbers",
                                 f"{expected}")
        optimiser[key] = type(value)(tensors[f"{name}.value"])
        restored = optimiser.state[key][0]
        moments = (type(t)(int(tensors[f"{name}.t"][0])), type(m)(tensors[f"{name}.m"]),
                   type(v)(tensors[f"{name}.v"]), extra)
        optimiser.state[key] = (restored, promoted, rate, moments)


def write_state(path: str | os.PathLike[str], tensors: dict[str, np.ndarray],
                metadata: dict[str, Any]) -> None:
    """Writes tensors and JSON values (step, random state, …) to one safetensors file, atomically."""
    with files.replacing(path) as beside:
        save_file(tensors, beside, metadata={_METADATA: json.dumps(metadata)})


def read_state(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what :func:`write_state` wrote.

    Raises:
        InputError: the file is missing or cannot be read.
    """
    try:
        with safe_open(Path(path), framework="numpy") as archive:
            metadata = json.loads((archive.metadata() or {})[_METADATA])
            return {name: archive.get_tensor(name) for name in archive.keys()}, metadata  # noqa: SIM118
    except FileNotFoundError:
        raise InputError(path, "no such file", "the training state to resume from") from None
    except (SafetensorError, OSError, ValueError, KeyError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a training state") from None
