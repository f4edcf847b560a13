"""Trained primitives in a Mitsuba scene, as its shape `ellipsoids`."""

from __future__ import annotations

import os

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.methods.gaussians.compositing import EXTENT, Y00, Posed
from ndf_mi.methods.gaussians.method import Gaussians


def performer(folder: str | os.PathLike[str], capture: Capture, frame: int) -> mi.Shape:
    """The performer of a saved training at a frame, for a scene that `volprim_rf_basic` renders:

        mi.load_dict({"type": "scene", "integrator": {"type": "volprim_rf_basic"},
                      "performer": performer("out/gaussians", capture, 12), ...})

    Its colours are sRGB, as the integrator expects by default. On the CPU, Mitsuba 3.9.1 meets some of the
    ellipsoids of millimetres that are metres away in a wrong order, or not at all: single precision does not
    suffice for the way in which it computes where rays enter them.

    Raises:
        InputError: the folder cannot be read, belongs to another capture, or there is no such frame.
    """
    method = Gaussians()
    method.load(folder, capture)
    return ellipsoids(method.posed(frame))


def ellipsoids(posed: Posed) -> mi.Shape:
    """Primitives in a pose as Mitsuba's shape, which has the attributes `opacities` and `sh_coeffs`."""
    with dr.suspend_grad():
        def columns(values: dr.ArrayBase) -> mi.TensorXf:
            return mi.TensorXf(np.ascontiguousarray(np.atleast_2d(np.array(values, np.float32)).T))

        return mi.load_dict({
            "type": "ellipsoids", "extent": EXTENT, "centers": columns(posed.centre),
            "scales": columns(posed.scale), "quaternions": columns(posed.rotation),
            "opacities": columns(posed.opacity), "sh_coeffs": columns((posed.colour - 0.5) / Y00)})
