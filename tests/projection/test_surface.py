from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.projection import PosedSurface, Surface

V = np.eye(4, 3)
F = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.zeros((3, 2))
G = np.array([[0, 1, 2], [0, 1, 2]])


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        ((F, None, None, V), "uv"),
        ((F, UV, G, V[:3]), "faces"),
        ((F - 1, UV, G, V), "faces"),
        ((F.astype(float), UV, G, V), "faces"),
        ((F[:0], UV, G[:0], V), "faces"),
        ((F, UV[:, :1], G, V), "uv"),
        ((F, UV, G[:1], V), "uv_faces"),
        ((F, UV[:2], G, V), "uv_faces"),
        ((F, UV * np.nan, G, V), "uv"),
        ((F, UV, G, np.full((4, 3), np.inf)), "reference_vertices"),
    ],
)
def test_what_is_wrong_is_named(arguments: tuple, where: str) -> None:
    with pytest.raises(InputError) as caught:
        Surface(*arguments)
    assert caught.value.where == where


@pytest.mark.parametrize(
    ("vertices", "band", "where"),
    [
        (V[:3].ravel(), 0.1, "vertices"),
        (np.full(12, np.nan), 0.1, "vertices"),
        (V.ravel(), 0.0, "band"),
        (V.ravel(), float("nan"), "band"),
    ],
)
def test_a_wrong_pose_is_named(vertices: np.ndarray, band: float, where: str) -> None:
    with pytest.raises(InputError) as caught:
        PosedSurface(Surface(F, UV, G, V), mi.Float(vertices.astype(np.float32)), band)
    assert caught.value.where == where
