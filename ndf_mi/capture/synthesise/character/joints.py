"""Which node of a character's rig is which joint of Anny's, by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, validated

#: Anny's joint for each name of a limb's joint, in the order of preference. Names are those that `_plain`
#: makes; those of Mixamo and Ready Player Me come first, then Unreal, 3ds Max Biped, VRM, Rigify and SMPL.
_LIMBS = {
    "UpLeg": ("upleg", "thigh", "upperleg", "hip"),
    "Leg": ("leg", "calf", "shin", "lowerleg", "knee"),
    "Foot": ("foot", "ankle"),
    "ToeBase": ("toebase", "toe", "toe0", "ball", "toes"),
    "Shoulder": ("shoulder", "clavicle", "collar"),
    "Arm": ("arm", "upperarm", "shoulder"),
    "ForeArm": ("forearm", "lowerarm", "elbow"),
    "Hand": ("hand", "wrist"),
    "HandFinger1": ("handmiddle1", "middle1", "middle01", "middleproximal", "fmiddle01", "finger2",
                    "handindex1", "index1", "index01", "indexproximal", "findex01", "finger1"),
}
_MIDDLE = {
    "Hips": ("hips", "pelvis", "hip", "root"),
    "LowerBack": ("spine", "spine01", "spine1", "spine0"),
    "Spine": ("spine1", "spine02", "chest", "spine2"),
    "Spine1": ("spine2", "spine03", "upperchest", "spine3"),
    "Neck": ("neck", "neck01", "neck0"),
    "Head": ("head",),
}
#: The joints without which nothing can be fitted.
REQUIRED = ("Head", *(f"{side}{name}" for side in ("Left", "Right")
                      for name in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")))
_PREFIX = re.compile(r"^(.*[:|]|mixamorig\d*|armature|bip\d*(001)?|j_bip|def|org|valvebiped)[\s_.-]*", re.I)


def match_joints(names: Sequence[str], candidates: Sequence[int], where: str,
                 mapping: Path | None = None) -> dict[str, int]:
    """The node of each of Anny's joints that the character has.

    Args:
        names: of all nodes.
        candidates: the nodes that may be joints, those nearer to the root first.
        mapping: a JSON file, ``{"LeftUpLeg": "name of a node", …}``, that goes before the known names.

    Raises:
        InputError: one of `REQUIRED` is not found; the message lists them and the character's names. Or the
            mapping names what does not exist.
    """
    known = [*_MIDDLE, *(f"{side}{name}" for side in ("Left", "Right") for name in _LIMBS)]
    found = {} if mapping is None else _given(names, known, mapping)
    by_name: dict[tuple[str, str], int] = {}
    for i in candidates:
        by_name.setdefault(_plain(names[i]), i)
    # Where elbows are called so, as in SMPL, shoulders are joints of the arms.
    elbows = any(name == "elbow" for _, name in by_name)
    for joint in known:
        side = next((side for side in ("left", "right") if joint.lower().startswith(side)), "")
        options = _LIMBS[joint[len(side):]] if side else _MIDDLE[joint]
        if elbows and joint.endswith("Shoulder"):
            options = ("collar", "clavicle")
        free = (by_name[side, name] for name in options if (side, name) in by_name)
        node = next((node for node in free if node not in found.values()), None)
        if joint not in found and node is not None:
            found[joint] = node
    missing = [joint for joint in REQUIRED if joint not in found]
    if missing:
        listed = ", ".join(names[i] for i in candidates[:60] if names[i])
        raise InputError(where, f"no {', '.join(missing)} among the joints {listed}",
                         "a human rig with names such as those of Mixamo",
                         "Write which node is which with --joints FILE.json: {\"LeftUpLeg\": \"name\", …}.")
    return found


def _given(names: Sequence[str], known: Sequence[str], mapping: Path) -> dict[str, int]:
    given = validated(load_json(mapping, "a JSON object of names"), dict[str, str], str(mapping))
    found = {}
    for joint, name in given.items():
        if joint not in known:
            raise InputError(f"{mapping}: {joint}", "an unknown joint", f"one of {', '.join(known)}")
        if name not in names:
            raise InputError(f"{mapping}: {joint}", repr(name),
                             f"a node: {', '.join(n for n in names[:60] if n)}")
        found[joint] = list(names).index(name)
    return found


def _plain(name: str) -> tuple[str, str]:
    """The side, ``left``, ``right`` or empty, and the rest of a joint's name, without prefix, case,
    separators and numbers that exporters add."""
    name = re.sub(r"_\d+$", "", name) if re.search(r"[A-Za-z]_0\d+$", name) else name
    while (short := _PREFIX.sub("", name)) != name and short:
        name = short
    name = re.sub(r"^[Cc][_.](?=[A-Z])", "", name)
    side = ""
    for pattern in (r"^(left|right)[\s_.-]*", r"[\s_.-]*(left|right)$", r"^(l|r)[\s_.-]+", r"[\s_.-]+(l|r)$"):
        match = re.search(pattern, name, re.I)
        if match:
            side = "left" if match[1][0] in "lL" else "right"
            name = name[: match.start()] + name[match.end():]
            break
    return side, re.sub(r"[\s_.-]", "", name).lower()


def order_by_depth(nodes: Sequence[int], parents: np.ndarray) -> list[int]:
    """Nodes, those nearer to the root first."""
    def depth(node: int) -> int:
        steps = 0
        while node >= 0:
            node, steps = int(parents[node]), steps + 1
        return steps

    return sorted(nodes, key=depth)
