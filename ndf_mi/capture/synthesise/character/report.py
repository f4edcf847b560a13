"""How well the fitted body matches the character: joints, outer surface and masks."""

from __future__ import annotations

from typing import Any

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.mesh import vertex_normals
from ndf_mi.body.motion import shaped_joints
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import joint_transforms
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.silhouette import Silhouettes, agreement
from ndf_mi.capture.synthesise.character.fit import JOINT_SPREAD, Target, limb
from ndf_mi.capture.synthesise.character.skin import Mesh

#: Metres: where the body is as close as this, it counts as bare or in tight clothes.
_CLOSE = 0.03
_FRAMES = 8


def describe_fit(
    body: Body, poses: Poses, target: Target, mesh: Mesh, cameras: list[Camera]
) -> dict[str, Any]:
    """Figures of a fit, for JSON.

    Returns:
        ``joints_mm``: by joint, mean distance to the character's; ``surface_mm``: quantiles of the body's
        height over the nearest outer surface that faces the same way, negative inside; ``outside``: fraction
        of vertices more than 10 mm outside; ``iou``: of the silhouettes of body and character.
    """
    names = [name for name in target.joints if limb(name) in JOINT_SPREAD]
    heights, errors, overlaps = [], [], []
    casters = [Silhouettes(faces, vertices.shape[1])
               for faces, vertices in ((body.faces, poses.vertices), (mesh.faces, mesh.vertices))]
    for frame in np.unique(np.linspace(0, len(poses) - 1, _FRAMES).round().astype(int)):
        vertices = poses.vertices[frame].astype(float)
        normals = vertex_normals(vertices, body.faces)
        height, _, near = target.skin.heights(frame, vertices, normals, 0.3)
        heights.append(height[near])
        errors.append(_joint_errors(body, poses, target, names, frame))
        casters[0].pose(vertices)
        casters[1].pose(mesh.vertices[frame])
        drawn = [[caster.draw(camera) for camera in cameras] for caster in casters]
        overlaps.append(agreement(*drawn))
    height = np.concatenate(heights) * 1000
    joints = np.mean(errors, axis=0) * 1000
    levels = (5, 25, 50, 75, 95)
    close = np.abs(height[np.abs(height) < _CLOSE * 1000])
    return {
        "joints_mm": {name: round(float(value), 1) for name, value in zip(names, joints, strict=True)},
        "joints_mean_mm": round(float(joints.mean()), 1),
        "surface_mm": {f"{level}%": round(float(np.percentile(height, level)), 1) for level in levels},
        "within_30_mm": round(float(len(close) / len(height)), 3),
        "outside": round(float((height > 10).mean()), 4),
        "iou": round(float(np.mean(overlaps)), 4),
        "shape": {name: round(float(value), 3) for name, value in
                  zip(body.shape_names or (), () if poses.shape is None else poses.shape, strict=True)},
    }


def _joint_errors(body: Body, poses: Poses, target: Target, names: list[str], frame: int) -> np.ndarray:
    """(n,) metres between the body's joints and the character's."""
    assert body.joint_names is not None
    transforms = joint_transforms(body, poses.pose[frame], poses.root_rotation[frame],
                                  poses.translation[frame], poses.shape)
    matrices = np.asarray(transforms.matrices, dtype=float).reshape(-1, 3, 4)
    rest = shaped_joints(body, poses.shape)
    at = np.einsum("jik,jk->ji", matrices[:, :, :3], rest) + matrices[:, :, 3]
    wanted = target.world[frame, [target.joints[name] for name in names], :3, 3]
    return np.linalg.norm(at[[body.joint_names.index(name) for name in names]] - wanted, axis=1)
