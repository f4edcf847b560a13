"""The textured mesh on a sphere whose texture is known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.methods.base import Budget
from ndf_mi.methods.mesh import TexturedMesh
from ndf_mi.methods.offset_mesh import OffsetMesh


def box_psnr(capture, method, camera: str, frame: int) -> float:
    image = method.render(capture.cameras[camera], frame)
    assert image.dtype == np.float32 and image.min() >= 0 and image.max() <= 1
    mask = metrics.box_mask(capture.cameras[camera], capture.poses.vertices[capture.poses.index(frame)])
    return metrics.psnr(capture.image(camera, frame), image, mask)


@pytest.fixture(scope="module")
def trained(capture) -> TexturedMesh:
    mesh = TexturedMesh(texture=64, rate=0.1)
    mesh.fit(capture, Budget(seconds=3.0, seed=1))
    return mesh


def test_it_recovers_the_texture(capture, trained):
    assert box_psnr(capture, trained, "c0", 2) > 35
    assert box_psnr(capture, trained, "n0", 2) > 33
    assert box_psnr(capture, trained, "n1", 7) > 33


def test_metadata(trained, capture):
    known = trained.metadata()
    assert known["budget"] == 3.0 and known["steps"] > 10 and 0.5 < known["seen"] <= 1 and not known["sweep"]
    assert (
        known["tuned"] == {"rate": 0.1}
        and known["options"] == {"texture": 64}
        and known["capture"] == capture.digest
    )
    json.dumps(known, allow_nan=False)


def test_saved_and_loaded_it_renders_the_same(capture, trained, tmp_path):
    trained.save(tmp_path / "mesh")
    loaded = TexturedMesh()
    loaded.load(tmp_path / "mesh", capture)
    camera = capture.cameras["n0"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert (
        json.dumps(loaded.metadata()) == json.dumps(trained.metadata())
        and loaded.cache_key() == trained.cache_key()
    )


def test_damaged_files_are_named(capture, trained, tmp_path):
    trained.save(tmp_path)
    with pytest.raises(InputError, match="mesh.json.*offset_rate"):
        OffsetMesh().load(tmp_path, capture)
    document = json.loads((tmp_path / "mesh.json").read_text())
    for change, words in (
        ({"version": 9}, "version"),
        ({"size": 0}, "size"),
        ({"seed": "x"}, "seed"),
        ({"more": 1}, "more"),
        ({"capture": "0"}, "capture"),
    ):
        (tmp_path / "mesh.json").write_text(json.dumps({**document, **change}))
        with pytest.raises(InputError, match=f"mesh.json.*{words}"):
            TexturedMesh().load(tmp_path, capture)
    (tmp_path / "mesh.json").write_text(json.dumps({**document, "size": 32}))
    with pytest.raises(InputError, match=r"texture.*\(32, 32, 3\)"):
        TexturedMesh().load(tmp_path, capture)
    (tmp_path / "mesh.safetensors").write_bytes(b"truncated")
    with pytest.raises(InputError, match="mesh.safetensors"):
        TexturedMesh().load(tmp_path, capture)
    with pytest.raises(InputError, match="mesh.json"):
        TexturedMesh().load(tmp_path / "nothing", capture)


def test_a_record_of_an_earlier_version_is_read(capture, trained, tmp_path):
    """Its members as the first version wrote them, in its order."""
    trained.save(tmp_path)
    (tmp_path / "mesh.json").write_text(
        json.dumps(
            {
                "version": 1,
                "size": 64,
                "rate": 0.1,
                "sweep": {"0.1": 0.01},
                "sweep_seconds": 2,
                "budget": None,
                "seconds": 7.5,
                "steps": 90,
                "converged": True,
                "seen": 0.75,
                "seed": 0,
                "capture": capture.digest,
                "history": [[50, 4.0, 0.02], [90, 7.5, 0.01]],
            }
        )
    )
    mesh = TexturedMesh()
    mesh.load(tmp_path, capture)
    assert mesh.metadata()["history"][1] == (90, 7.5, 0.01) and mesh.metadata()["converged"]
