"""A rigged, textured and animated character of boxes as a GLB file, made in memory."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

#: Joints in centimetres, in a T-pose, with their parents: (name, parent, position).
JOINTS = [
    ("Hips", None, (0, 96, 0)), ("Spine", "Hips", (0, 106, 0)), ("Spine1", "Spine", (0, 118, 0)),
    ("Spine2", "Spine1", (0, 130, 0)), ("Neck", "Spine2", (0, 146, 0)), ("Head", "Neck", (0, 156, 1)),
    *((f"{side}{name}", f"{side}{parent}" if parent[0] in "ULFA" else parent, (sign * x, y, z))
      for side, sign in (("Left", 1), ("Right", -1)) for name, parent, (x, y, z) in (
        ("UpLeg", "Hips", (10, 92, 0)), ("Leg", "UpLeg", (10, 50, 1)), ("Foot", "Leg", (10, 9, -1)),
        ("ToeBase", "Foot", (10, 2, 11)), ("Arm", "Spine2", (18, 140, 0)),
        ("ForeArm", "Arm", (46, 140, 0)), ("Hand", "ForeArm", (70, 140, 0)))),
]  # fmt: skip
#: Half the size of the box around each bone, from its joint to the next, centimetres.
_THICK = 6.0


class Glb:
    """A GLB file in the making: ``json``, and the arrays that have been added."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self._data = b""

    def view(self, data: bytes, **keys: Any) -> int:
        """The index of a new buffer view."""
        self._data += b"\0" * (-len(self._data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data),
                                         **keys})
        self._data += data
        return len(self.json["bufferViews"]) - 1

    def array(self, values: Any, kind: str, of: type = np.float32, **keys: Any) -> int:
        """The index of a new accessor."""
        values = np.ascontiguousarray(values, dtype=of)
        code = {np.float32: 5126, np.uint16: 5123, np.uint8: 5121, np.int16: 5122}[of]
        self.json["accessors"].append({"bufferView": self.view(values.tobytes()), "componentType": code,
                                       "count": len(values), "type": kind, **keys})
        return len(self.json["accessors"]) - 1

    def bytes(self) -> bytes:
        """The file."""
        document = {**self.json, "buffers": [{"byteLength": max(len(self._data), 1)}]}
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        data = self._data + b"\0" * (-len(self._data) % 4)
        return (struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
                + struct.pack("<I4s", len(text), b"JSON") + text
                + struct.pack("<I4s", len(data), b"BIN\0") + data)

    def write(self, path: Path) -> Path:
        path.write_bytes(self.bytes())
        return path


def boxes() -> Glb:
    """A character of boxes with Mixamo's names, in centimetres below a node that scales by 0.01.

    Its animations: ``raise``, 1 s, in which the left arm turns from 0 to 90° about z, linearly; and ``walk``,
    2 s, in which the legs swing by 30° on splines.
    """
    glb = Glb()
    names = [name for name, _, _ in JOINTS]
    at = np.array([position for _, _, position in JOINTS], dtype=float)
    parents = [names.index(parent) if parent else -1 for _, parent, _ in JOINTS]
    vertices, faces, owners = [], [], []
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
    for j in range(len(names)):
        ends = [at[k] for k, p in enumerate(parents) if p == j] or [at[j] + [0, 12, 0] if names[j] == "Head"
                                                                    else at[j]]
        end = np.mean(ends, axis=0)
        half = np.abs(end - at[j]) / 2 + (_THICK if "Foot" not in names[j] and "Toe" not in names[j] else 2)
        faces.append(triangles + 8 * len(vertices))
        vertices.append((at[j] + end) / 2 + cube * half)
        owners += [j] * 8
    points = np.concatenate(vertices)
    inverse = np.tile(np.eye(4), (len(names), 1, 1))
    inverse[:, :3, 3] = -at
    weights = np.zeros((len(points), 4))
    weights[:, 0] = 1
    picture = io.BytesIO()
    colours = np.zeros((2, 2, 3), np.uint8)
    colours[..., 0], colours[0, :, 1] = 200, 100
    Image.fromarray(colours).save(picture, "PNG")
    glb.json |= {
        "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Armature", "scale": [0.01] * 3, "children": [1 + names.index("Hips"),
                                                                          1 + len(names)]},
                  *({"name": f"mixamorig:{name}", "translation": (at[j] - (at[parents[j]] if parents[j] >= 0
                                                                           else 0)).tolist(),
                     "children": [1 + k for k, p in enumerate(parents) if p == j]}
                    for j, name in enumerate(names)),
                  {"name": "Body", "mesh": 0, "skin": 0}],
        "meshes": [{"name": "Body", "primitives": [{"material": 0, "attributes": {
            "POSITION": glb.array(points, "VEC3"),
            "TEXCOORD_0": glb.array(np.tile([[0.25, 0.25]], (len(points), 1)), "VEC2"),
            "JOINTS_0": glb.array(np.stack([owners, *[[0] * len(owners)] * 3], axis=1), "VEC4", np.uint8),
            "WEIGHTS_0": glb.array(weights, "VEC4")},
            "indices": glb.array(np.concatenate(faces).ravel(), "SCALAR", np.uint16)}]}],
        "skins": [{"joints": list(range(1, 1 + len(names))), "inverseBindMatrices": glb.array(
            inverse.swapaxes(1, 2).reshape(-1, 16), "MAT4")}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0},
                                                "baseColorFactor": [1, 1, 0.5, 1]}}],
        "textures": [{"source": 0}], "images": [{"bufferView": glb.view(picture.getvalue())}],
    }  # fmt: skip
    node = {name: 1 + j for j, name in enumerate(names)}
    turned = Rotation.from_euler("z", [[0], [90]], degrees=True).as_quat()
    swing = Rotation.from_euler("x", [[30], [-30], [30]], degrees=True).as_quat()
    splines = np.stack([0 * swing, swing, 0 * swing], axis=1).reshape(-1, 4)
    back = splines * [-1, 1, 1, 1]
    times = glb.array([0, 1, 2], "SCALAR")
    glb.json["animations"] = [
        {"name": "raise",
         "channels": [{"sampler": 0, "target": {"node": node["LeftArm"], "path": "rotation"}}],
         "samplers": [{"input": glb.array([0, 1], "SCALAR"), "output": glb.array(turned, "VEC4")}]},
        {"name": "walk", "channels": [{"sampler": k, "target": {"node": node[f"{side}UpLeg"],
                                                               "path": "rotation"}}
                                      for k, side in enumerate(("Left", "Right"))],
         "samplers": [{"input": times, "output": glb.array(values, "VEC4"), "interpolation": "CUBICSPLINE"}
                      for values in (splines, back)]}]
    return glb
