"""The mesh with offsets on a sphere that is smaller than what the images show."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget
from ndf_mi.methods.mesh import TexturedMesh
from ndf_mi.methods.offset_mesh import OffsetMesh


@pytest.fixture(scope="module")
def trained(shrunk_capture) -> OffsetMesh:
    mesh = OffsetMesh(texture=32, rate=0.05, offset_rate=0.02)
    mesh.fit(shrunk_capture, Budget(seconds=8.0, seed=1))
    return mesh


def test_offsets_beat_the_texture_alone(shrunk_capture, trained):
    bare = TexturedMesh(texture=32, rate=0.05)
    bare.fit(shrunk_capture, Budget(seconds=2.0, seed=1))
    camera, truth = shrunk_capture.cameras["n0"], shrunk_capture.image("n0", 7)
    errors = [float(((mesh.render(camera, 7) - truth) ** 2).mean()) for mesh in (trained, bare)]
    assert errors[0] < 0.5 * errors[1]


def test_metadata(trained):
    known = trained.metadata()
    lengths = 1000 * np.linalg.norm(trained.offsets, axis=1)
    assert known["offset_median_mm"] == pytest.approx(np.median(lengths)) and known["offset_median_mm"] > 20
    assert known["offset_max_mm"] == pytest.approx(lengths.max())
    assert (
        known["budget"] == 8.0
        and known["steps"] > 5
        and known["tuned"] == {"rate": 0.05, "offset_rate": 0.02}
    )
    assert f"{known['offset_median_mm']:.0f} mm" in known["note"]


def test_saved_and_loaded_it_renders_the_same(shrunk_capture, trained, tmp_path):
    trained.save(tmp_path)
    loaded = OffsetMesh()
    loaded.load(tmp_path, shrunk_capture)
    camera = shrunk_capture.cameras["n0"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert json.dumps(loaded.metadata()) == json.dumps(trained.metadata())
    assert loaded.cache_key() == trained.cache_key()
    with pytest.raises(InputError, match="mesh.json.*offset"):
        TexturedMesh().load(tmp_path, shrunk_capture)
