"""Scenes around a ball of constant density, and rays through them, for `ndf_path`."""

import drjit as dr
import mitsuba as mi
import numpy as np

RADIUS, BAND = 0.3, 0.08
SIGMA = 6.0
FINE = 500  # samples, where a closed form is met
T = mi.ScalarTransform4f
FLOOR = T().translate([0, -0.5, 0]).rotate([1, 0, 0], -90).scale(3)


def performer(run, frame=0, scale=1.0, bsdf="null"):
    return {"type": "ndf_shell", "run": str(run.path), "frame": frame, "bsdf": {"type": bsdf},
            "interior": {"type": "ndf", "run": str(run.path), "frame": frame, "scale": scale}}


def grey(value):
    return {"type": "rgb", "value": value}


def diffuse(reflectance, transform):
    bsdf = {"type": "twosided", "b": {"type": "diffuse", "reflectance": grey(reflectance)}}
    return {"type": "rectangle", "to_world": transform, "bsdf": bsdf}


def glowing(radiance, transform):
    return {"type": "rectangle", "to_world": transform, "bsdf": {"type": "diffuse", "reflectance": grey(0.0)},
            "emitter": {"type": "area", "radiance": grey(radiance)}}


def scene_of(integrator="ndf_path", size=24, origin=(0, 0, 2.0), shapes=None, background=None,
             sampler="independent", **options):
    light = {} if background is None else {"light": {"type": "constant", "radiance": grey(background)}}
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": integrator, **options},
        "sensor": {
            "type": "perspective", "fov": 28, "near_clip": 1e-3,
            "to_world": T().look_at(list(origin), [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"},
                     "pixel_format": "rgb"},
            "sampler": {"type": sampler},
        },
        **light, **(shapes or {}),
    })


def rays(origins, directions):
    o, d = np.broadcast_arrays(np.asarray(origins, np.float32), np.asarray(directions, np.float32))
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return mi.Ray3f(mi.Point3f(np.ascontiguousarray(o.T)),
                    mi.Vector3f(np.ascontiguousarray(d.T, dtype=np.float32)))


def radiance(scene, origins, directions, spp=1, seed=0):
    """(N, 3) mean radiance along rays."""
    ray = rays(np.repeat(origins, spp, 0), np.repeat(directions, spp, 0))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(ray.d))
    L = scene.integrator().sample(dr.ADMode.Primal, scene, sampler, ray)[0]
    return np.moveaxis(mi.Color3f(L).numpy(), 0, -1).reshape(len(origins), spp, 3).mean(1)


def chord(o, d, centre=(0, 0, 0), end=np.inf):
    """Length of rays' way through the band of the ball, up to a distance; float64."""
    o, d = np.asarray(o, np.float64) - centre, np.asarray(d, np.float64)
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    middle = -(o * d).sum(-1)
    apart2 = (o * o).sum(-1) - middle**2

    def within(radius):
        half = np.sqrt(np.maximum(radius**2 - apart2, 0))
        return np.clip(middle + half, 0, end) - np.clip(middle - half, 0, end)

    return within(RADIUS + BAND) - within(RADIUS - BAND)


def fan(n=200, origin=(0, 0, 2.0), spread=0.25, seed=4):
    """Rays from one point around the direction of the ball's centre."""
    rng = np.random.default_rng(seed)
    origins = np.repeat(np.asarray(origin, np.float64)[None], n, 0)
    return origins, -origins / np.linalg.norm(origin) + rng.uniform(-spread, spread, (n, 3))


def assert_close(seen, expected, mean=3e-3, most=0.02):
    """But for rays that graze the band, whose way through the mesh's band is not that through a ball's."""
    error = np.abs(seen - np.broadcast_to(expected, seen.shape))
    assert error.mean() < mean and np.quantile(error, 0.98) < most, (error.mean(), np.quantile(error, 0.98))


# Without performers, and with nothing else.
