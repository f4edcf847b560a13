"""LPIPS, where the package `lpips` and its weights are there; both are the user's to install."""

from __future__ import annotations

import importlib
import importlib.util
from functools import cache
from typing import Any

import numpy as np

INSTALL = "pip install lpips"
NETWORK = "alex"
"""The network whose features are compared; the one that LPIPS recommends as a metric."""
LEAST = 64
"""Pixels a side below which images are padded with zeros: the network needs some."""


@cache
def absence() -> str:
    """Why there is no LPIPS, a sentence for readers; empty if there is."""
    if importlib.util.find_spec("lpips") is None:
        return f"LPIPS is not measured, because the package lpips is not installed: {INSTALL}."
    try:
        _network()
    except Exception as error:
        # Whatever it is, such as weights that cannot be downloaded: the other figures do not depend on it.
        reason = str(error).splitlines() or [type(error).__name__]
        return (f"LPIPS is not measured, because its network cannot be loaded ({reason[0]}). {INSTALL} "
                "installs it; its weights are downloaded when it is first used.")
    return ""


def lpips(truth: np.ndarray, image: np.ndarray) -> float:
    """Perceptual distance of two (h, w, 3) sRGB images in [0, 1] (Zhang et al. 2018, version 0.1): 0 means
    equal. Call it only if `absence` is empty.
    """
    torch = importlib.import_module("torch")
    with torch.no_grad():
        found = _network()(*(torch.from_numpy(_prepared(side)) for side in (truth, image)))
    return float(np.asarray(found).ravel()[0])


@cache
def _network() -> Any:
    return importlib.import_module("lpips").LPIPS(net=NETWORK, verbose=False).eval()


def _prepared(image: np.ndarray) -> np.ndarray:
    """(1, 3, h, w) float32 in [-1, 1], contiguous, at least `LEAST` pixels a side."""
    height, width = image.shape[:2]
    padding = ((0, max(LEAST - height, 0)), (0, max(LEAST - width, 0)), (0, 0))
    padded = np.pad(np.clip(image, 0, 1), padding)
    return np.ascontiguousarray(2 * padded.transpose(2, 0, 1)[None] - 1, dtype=np.float32)
