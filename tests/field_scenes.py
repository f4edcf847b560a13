"""Scenes of a performer under Mitsuba's integrators."""

from __future__ import annotations

import mitsuba as mi

RADIUS, BAND, SIZE = 0.3, 0.08, 8


def sensor(origin=(0, 0, 2.0), target=(0, 0, 0), fov=28, size=SIZE, **more):
    return {
        "type": "perspective", "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(list(origin), list(target), [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"},
                 "pixel_format": "rgb"},
        "sampler": {"type": "independent"}, **more,
    }


def performer(run, layers=3, frame=0, cell=0.0125, **more):
    return {"type": "ndf_shell", "layers": layers, "cell": cell,
            "interior": {"type": "ndf", "run": str(run.path), "frame": frame, **more}}


def scene_of(shapes, integrator="volpath", camera=None, depth=2, **more):
    own = {} if integrator.startswith("ndf") else {"max_depth": depth, "rr_depth": 1000}
    # A reference must come after what it refers to.
    return mi.load_dict({"type": "scene", "integrator": {"type": integrator, **own, **more},
                         "light": {"type": "constant"}, **shapes,
                         "sensor": camera or sensor()})
