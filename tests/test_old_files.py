"""Files that ndf-mi 0.1.0 wrote (tests/data/v1) are read, rendered, and continued from."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.commands import main
from ndf_mi.planning.plan import read_preset
from ndf_mi.render.image import ImageRenderer
from ndf_mi.run import Run

V1 = Path(__file__).parent / "data" / "v1"


@pytest.fixture
def old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the old files, as the working directory: they hold relative paths."""
    monkeypatch.chdir(shutil.copytree(V1, tmp_path / "v1"))
    return tmp_path / "v1"


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def stamps(folder: Path, pattern: str) -> dict[Path, int]:
    found = {file: file.stat().st_mtime_ns for file in folder.rglob(pattern)}
    assert found
    return found


def test_a_capture_has_the_same_digest(old: Path) -> None:
    assert main(["capture", "check", "capture"]) == 0
    assert Capture.read(old / "capture").digest == read(old / "run" / "config.json")["capture"]["digest"]


def test_a_run_renders_the_same_picture(old: Path) -> None:
    run, capture = Run.load(old / "run"), Capture.read(old / "capture")
    expected = np.load(old / "expected.npz")
    image = ImageRenderer(samples=64)(run.posed(5), capture.cameras["n0"], geometry=True)
    assert image.opacity.max() > 0.5
    for name in expected:
        np.testing.assert_allclose(getattr(image, name), expected[name], atol=2e-5, err_msg=name)


def test_a_stopped_training_goes_on_as_if_it_had_not_stopped(old: Path) -> None:
    assert main(["optimise", "capture", "-o", "run-stopped", "--resume"]) == 0
    expected = read(old / "expected.json")["end"]
    last = json.loads((old / "run-stopped" / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["step"] == expected["step"]
    assert last["loss"] == pytest.approx(expected["loss"], rel=2e-3)


def test_a_scattering_run_is_known_as_one() -> None:
    run = Run.load(V1 / "run-scattering")
    assert run.scattered and run.colours == "albedo"


def test_a_plan_is_read(old: Path) -> None:
    capture = Capture.read(old / "capture")
    preset, document = read_preset(old / "plan.json", capture.digest, "body")
    assert preset.name == "planned" and document["findings"]


def test_a_comparison_keeps_its_meshes_and_their_figures(old: Path) -> None:
    before, meshes = read(old / "compare" / "compare.json"), stamps(old / "compare", "mesh.safetensors")
    assert (
        main(
            [
                "compare",
                "run",
                "--capture",
                "capture",
                "-o",
                "compare",
                "--max-images",
                "1",
                "--texture",
                "16",
                "--samples",
                "16",
                "--sequence",
                "2",
                "--mesh-seconds",
                "0.5",
            ]
        )
        == 0
    )
    after = read(old / "compare" / "compare.json")
    # A time that is given is the only one that methods are trained for.
    kept = [method for method in before["methods"] if not method["key"].endswith("-converged")]
    assert [method["key"] for method in after["methods"]] == [method["key"] for method in kept]
    assert stamps(old / "compare", "mesh.safetensors") == meshes
    for was, now in zip(kept, after["methods"], strict=True):
        assert now["means"]["novel_view"]["box_psnr"] == pytest.approx(
            was["means"]["novel_view"]["box_psnr"], abs=0.01
        )
    assert "data:image/png" in (old / "compare" / "report.html").read_text(encoding="utf-8")


def test_an_ablation_keeps_its_runs(old: Path) -> None:
    before, fields = read(old / "ablation" / "ablation.json"), stamps(old / "ablation", "field.safetensors")
    options = [
        "grid_levels=2",
        "grid_entries=256",
        "direction_octaves=-1",
        "strata=2",
        "coordinates=texel",
        "surface=body",
        "held_back=0",
        "mask_trust=false",
        "rays=256",
        "samples=24",
    ]
    assert (
        main(
            [
                "ablate",
                "capture",
                "-o",
                "ablation",
                "--only",
                "no-pose",
                "--preset",
                "tiny",
                "--steps",
                "4",
                "--max-images",
                "1",
                "--sequence",
                "2",
                "--samples",
                "16",
                *(word for option in options for word in ("--option", option)),
            ]
        )
        == 0
    )
    after = read(old / "ablation" / "ablation.json")
    assert [method["key"] for method in after["methods"]] == ["full", "no-pose"]
    assert stamps(old / "ablation", "field.safetensors") == fields
    for was, now in zip(before["methods"], after["methods"], strict=True):
        assert now["means"]["novel_pose"]["box_psnr"] == pytest.approx(
            was["means"]["novel_pose"]["box_psnr"], abs=0.01
        )


def test_a_relighting_keeps_its_mesh(old: Path) -> None:
    meshes = stamps(old / "relight", "mesh.safetensors")
    assert (
        main(
            [
                "relight",
                "run-scattering",
                "--capture",
                "day",
                "--under",
                "night",
                "-o",
                "relight",
                "--spp",
                "2",
                "--texture",
                "8",
                "--max-images",
                "1",
            ]
        )
        == 0
    )
    assert stamps(old / "relight", "mesh.safetensors") == meshes
    for light in ("seen", "unseen"):
        assert [method["key"] for method in read(old / "relight" / f"{light}.json")["methods"]] == [
            "ndf",
            "mesh",
        ]
    assert (old / "relight" / "report.html").is_file()


def test_a_tradeoff_keeps_its_fields(old: Path) -> None:
    fields = stamps(old / "tradeoff", "field.safetensors")
    before = {row["key"]: row for row in read(old / "tradeoff" / "tradeoff.json")["points"]}
    assert (
        main(
            [
                "tradeoff",
                "run",
                "--capture",
                "capture",
                "-o",
                "tradeoff",
                "--only",
                "size",
                "--steps",
                "4",
                "--views",
                "1",
                "--timed",
                "1",
                "--repeats",
                "1",
            ]
        )
        == 0
    )
    assert stamps(old / "tradeoff", "field.safetensors") == fields
    after = {row["key"]: row for row in read(old / "tradeoff" / "tradeoff.json")["points"]}
    assert {"usual", "size-0.5"} <= set(after)
    psnr = [rows["usual"]["figures"][0]["truth"]["box_psnr"] for rows in (before, after)]
    assert psnr[1] == pytest.approx(psnr[0], abs=0.01)
