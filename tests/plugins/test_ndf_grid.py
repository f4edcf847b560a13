"""The medium on a grid against Mitsuba's grid medium; it moves without compiling anything."""

import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

SHAPE, CELL = (12, 10, 14), 0.1


def nodes(seed=0):
    """(nz, ny, nx, 4) densities and scattering coefficients, zero on the border."""
    nx, ny, nz = SHAPE
    rng = np.random.default_rng(seed)
    values = np.zeros((nz, ny, nx, 4), np.float32)
    inner = values[1:-1, 1:-1, 1:-1]
    inner[..., 0] = 12 * rng.random(inner.shape[:-1]) ** 2
    inner[..., 1:] = inner[..., :1] * np.array([0.9, 0.6, 0.3])
    return values


def filled(values, low):
    nx, ny, nz = SHAPE
    medium = mi.load_dict({"type": "ndf_grid", "nx": nx, "ny": ny, "nz": nz, "cell": CELL})
    medium.fill(mi.Float(values.ravel()), mi.Point3f(*map(float, low)), mi.Float(float(values[..., 0].max())))
    return medium


def scene_of(medium, low, integrator):
    extent = CELL * (np.array(SHAPE) - 1)
    box = mi.ScalarTransform4f().translate(list(low + extent / 2)).scale(list(extent / 2))
    look = mi.ScalarTransform4f().look_at(list(low + extent / 2 + [0.3, 0.5, 3.0]), list(low + extent / 2),
                                          [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    return mi.load_dict({
        "type": "scene", "integrator": {"type": integrator, "max_depth": 5, "rr_depth": 1000},
        "sky": {"type": "constant"},
        "sun": {"type": "directional", "direction": [0.3, -1, -0.4], "irradiance": 2.0},
        "box": {"type": "cube", "to_world": box, "bsdf": {"type": "null"}, "interior": medium},
        "sensor": {"type": "perspective", "fov": 30, "to_world": look, "film": film},
    })


def means(scene, count=6):
    return np.array([mi.render(scene, spp=128, seed=seed).numpy().mean((0, 1)) for seed in range(count)],
                    dtype=np.float64)


@pytest.mark.parametrize("integrator", ["volpath", "prbvolpath"])
def test_it_agrees_with_mitsubas_grid_medium(integrator):
    values, low = nodes(), np.array([0.3, -0.2, 0.1])
    ours = filled(values, low)
    # Mitsuba's grids have their values in the middles of cells.
    size = CELL * np.array(SHAPE)
    placed = mi.ScalarTransform4f().translate(list(low - CELL / 2)).scale(list(size))
    albedo = np.where(values[..., :1] > 0, values[..., 1:] / np.maximum(values[..., :1], 1e-9),
                      [0.9, 0.6, 0.3])
    grids = {name: {"type": "gridvolume", "grid": mi.VolumeGrid(np.ascontiguousarray(grid, np.float32)),
                    "to_world": placed,
                    "wrap_mode": "clamp"} for name, grid in (("sigma_t", values[..., :1]),
                                                             ("albedo", albedo))}
    theirs = mi.load_dict({"type": "heterogeneous", **grids})
    a, b = (means(scene_of(medium, low, integrator)) for medium in (ours, theirs))
    noise = np.sqrt(a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b))
    assert (np.abs(a.mean(0) - b.mean(0)) < 4 * noise).all(), (a.mean(0), b.mean(0), noise)
    assert (noise < 0.01 * b.mean(0)).all()


def test_the_majorant_is_strictly_above_every_density():
    values = nodes()
    medium = filled(values, (0, 0, 0))
    assert float(medium.majorant[0]) == pytest.approx(1.05 * values[..., 0].max())
    assert float(filled(np.zeros_like(values), (0, 0, 0)).majorant[0]) > 0


def kernels_of_moves() -> list[bool]:
    """Whether each kernel that pictures launch after the medium is moved and filled again was compiled."""
    medium = filled(nodes(), (0, 0, 0))
    scene = scene_of(medium, np.zeros(3), "volpath")
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for move in range(8):
            # Dr.Jit may order the same code in two ways; the first pictures compile both.
            if move == 4:
                dr.kernel_history_clear()
            medium.fill(mi.Float(nodes(move).ravel()), mi.Point3f(0.01 * move, 0.02, 0.0), mi.Float(12.0))
            mi.render(scene, spp=4, seed=move)
        return [not kernel["cache_hit"] for kernel in dr.kernel_history([dr.KernelType.JIT])
                if kernel["size"] > 1]


def test_moving_and_filling_compile_nothing():
    # In a process of its own: kernels contain every medium that exists, those of other tests included.
    program = ("import runpy; from ndf_mi import variants; variants.use(); "
               f"print(*runpy.run_path({__file__!r})['kernels_of_moves']())")
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() and "True" not in found.stdout


def test_wrong_sizes_are_named():
    for change, word in (({"nx": 1}, "nx"), ({"cell": 0.0}, "cell")):
        with pytest.raises(Exception, match=word):
            mi.load_dict({"type": "ndf_grid", "nx": 4, "ny": 4, "nz": 4, "cell": 0.1, **change})
