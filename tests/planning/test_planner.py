"""Whole plans of a tiny capture, and trainings that use them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.field import Field, Preset
from ndf_mi.planning.plan import Plan
from ndf_mi.planning.planner import full_model, plan, put_back
from ndf_mi.run import Run


def test_only_training_images_are_read(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: set[tuple[str, int]] = set()
    for name in ("image", "mask"):
        read = getattr(Capture, name)

        def noted(self: Capture, camera: str, frame: int, read: Any = read) -> np.ndarray:
            looked.add((camera, frame))
            return read(self, camera, frame)

        monkeypatch.setattr(Capture, name, noted)
    found = plan(capture)
    assert looked == set(capture.splits["train"])
    assert found.looked_at == {"cameras": list(capture.splits["train"].cameras),
                               "frames": list(capture.splits["train"].frames)}


def test_a_sphere_that_glows_needs_neither_pose_nor_light_nor_view(planned: Plan) -> None:
    preset = planned.preset
    assert (preset.pose_layers, preset.deformation_layers, preset.normal_octaves,
            preset.direction_octaves) == ((), (), -1, -1)
    full = full_model()
    assert preset.band + preset.band_inside < 0.75 * (full.band + full.band_inside)
    assert {finding.key for finding in planned.findings} >= {"pose", "light", "view", "band", "detail",
                                                             "scattering"}
    assert all(finding.evidence and finding.follows for finding in planned.findings)


def test_what_one_finding_removed_can_be_restored(planned: Plan) -> None:
    full, left_out = full_model(), planned.preset
    network = {"colour_layers", "feature_width"}
    # Restoring an input of the colour restores the colour network, which would not exist otherwise.
    follows = {"pose_layers", "pose_products", "grid_features", "deformation_layers"}
    for key, changed in (("pose", follows | network), ("light", {"normal_octaves"} | network),
                         ("view", {"direction_octaves", "direction"} | network),
                         ("band", {"band", "band_inside"}), ("colour", network)):
        preset = put_back(planned, key)
        different = {field.name
                     for field in dataclasses.fields(Preset)
                     if getattr(preset, field.name) != getattr(left_out, field.name)}
        assert different == changed | {"name"}
        assert all(getattr(preset, name) == getattr(full, name) for name in changed)
    assert put_back(planned, "detail").grid_entries == full.grid_entries
    with pytest.raises(InputError, match="band"):
        put_back(planned, "hair")


def test_parts_left_out_have_no_weights_and_no_operations() -> None:
    full = dataclasses.replace(full_model(), grid_entries=2**10, grid_levels=2)
    sizes, operations = [], []
    for changes in ({}, {"pose_layers": (), "deformation_layers": ()},
                    {"direction_octaves": -1, "direction": "view"},
                    {"normal_octaves": -1}, {"colour_layers": (), "feature_width": 0}):
        full = dataclasses.replace(full, **changes)
        field = Field(full, joints=3)
        bound = field.bind(mi.Float(np.zeros(9, np.float32)), field.initial_parameters())
        bound.pack()
        lane = [mi.Float(np.linspace(0, 1, 64, dtype=np.float32) + 0.1 * i) for i in range(9)]
        d, n = dr.normalize(mi.Vector3f(*lane[3:6])), mi.Normal3f(dr.normalize(mi.Vector3f(*lane[6:9])))
        dr.eval(bound, lane, d, n)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(bound.fused(lane[:3], d, n))
            operations.append(sum(kernel["operation_count"]
                                  for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT))
        sizes.append(field.size)
        assert full.pose_layers or not any(name.startswith(("pose", "deform")) for name in field.layers)
        assert all(layer.pose == 0 for layer in field.layers.values()) or full.pose_layers
    assert sizes == sorted(set(sizes), reverse=True)
    # The last removes a layer but no operations: reading colours off a wider layer takes as many.
    assert operations[:-1] == sorted(set(operations[:-1]), reverse=True)


def test_the_commands_plan_print_and_train(capture: Capture, tmp_path: Path,
                                           capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.json"
    assert main(["plan", str(capture.path), "-o", str(file)]) == 0
    printed = capsys.readouterr().out
    for fact in ("left out", "pose features", "deformation net", "the body with offsets", str(file)):
        assert fact in printed
    for name, model in (("auto", "auto"), ("file", str(file))):
        run = tmp_path / name
        options = ["--steps", "2", "--option", "rays=64", "--option", "samples=16", "--option", "bands=local"]
        assert main(["optimise", str(capture.path), "-o", str(run), "--model", model, *options]) == 0
        config = json.loads((run / "config.json").read_text())
        assert config["plan"] == json.loads(file.read_text())
        assert Preset.from_dict(config["preset"]) == Preset.from_dict(config["plan"]["preset"])
        assert config["plan"]["surface"] == "offset"
        # Files have only the largest widths: the others are measured again.
        assert np.ptp(Run.load(run).bands[:, 0]) > 1e-4
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", str(file), "--option",
                 "surface=body"]) == 2
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", "auto", "--preset",
                 "paper"]) == 2
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", "none.json"]) == 2
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", str(file), "--option",
                 "atlas=one-piece"]) == 2
    assert main(["plan", str(capture.path), "--worth", "-1"]) == 2
    assert not (tmp_path / "x").exists()
