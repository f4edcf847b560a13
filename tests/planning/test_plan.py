"""Whole plans on a tiny capture: the stand-off told from masks, training images alone looked at, plans on disk, trainings by them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.field import Field, Preset
from ndf_mi.planning import findings
from ndf_mi.planning.appearance import UNTOLD, Estimate
from ndf_mi.planning.detail import Detail
from ndf_mi.planning.observations import chosen_frames, observe
from ndf_mi.planning.plan import Finding, Plan, Settings, read_preset
from ndf_mi.planning.planner import full_model, plan, put_back
from ndf_mi.planning.standoff import Disagreement, Standoff, standoff


@pytest.fixture(scope="module")
def planned(capture: Capture) -> Plan:
    return plan(capture)


def scaled(capture: Capture, factor: float) -> Capture:
    """The same images with a body of another size in them."""
    other = Capture.read(capture.path)
    middle = other.poses.vertices.mean(axis=1, keepdims=True)
    poses = {field.name: getattr(other.poses, field.name) for field in dataclasses.fields(Poses)}
    other.poses = Poses(**(poses | {"vertices": middle + factor * (other.poses.vertices - middle)}))
    return other


def test_observations_are_of_the_place_on_the_body_that_a_pixel_shows(capture: Capture) -> None:
    frames = chosen_frames(capture, 24)
    seen, views = observe(capture, frames)
    assert len(views) == len(capture.splits["train"])
    # The texture that the sphere was drawn with, which the fixture computes from the texture coordinates.
    u, v = 2 * np.pi * seen.uv[:, 0], seen.uv[:, 1]
    drawn = np.stack([0.5 + 0.3 * np.sin(u), 0.2 + 0.6 * v, 0.5 + 0.3 * np.cos(2 * u) * np.sin(np.pi * v)], -1)
    assert np.abs(seen.colour - drawn).mean() < 0.02
    np.testing.assert_allclose(np.linalg.norm(seen.rest, axis=1), 0.5, atol=0.01)
    # A sphere that only shifts: its normals stay, and nothing turns.
    assert np.abs(seen.turned).max() < 1e-5
    assert (np.sum(seen.normal * seen.away, axis=1) > 0.3).all()


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.08])
def test_the_stand_off_is_told_from_the_masks_to_a_pixel(capture: Capture, factor: float) -> None:
    other = scaled(capture, factor)
    frames = chosen_frames(other, 24)
    seen, views = observe(other, frames)
    found = standoff(other, frames, views)
    truth, pixel = 0.5 * (1 - factor), float(np.median(seen.footprint))
    assert found.outside.reach(0) == pytest.approx(max(truth, 0), abs=pixel)
    assert found.inside.reach(0) == pytest.approx(max(-truth, 0), abs=pixel)


def test_what_little_stands_off_far_is_left_out_where_it_costs_little() -> None:
    pixels = Disagreement(np.array([0.05, 0.01, 0.02, 0.01]), np.array([0.1, 0.5, 0.2, 0.5]))
    assert [pixels.reach(allowed) for allowed in (0.0, 0.15, 0.3, 0.35, 2.0)] == [0.05, 0.02, 0.02, 0.01, 0.0]


def test_what_masks_lack_inside_the_body_does_not_widen_the_band() -> None:
    settings, full = Settings(), full_model()
    fine = Detail(0.01, 0.02, 0.01, {2: 1.0, 4: 1.0, 8: 1.0}, 1.0, 0.5)

    def about(outside: float, inside: float) -> Finding:
        beside = [Disagreement(np.full(1000, depth), np.full(1000, 1.0)) for depth in (outside, inside)]
        return findings.about_band(Standoff(beside[0], beside[1], 5000), fine, settings, full)

    usual, hidden = about(0.02, 0.0), about(0.02, 0.2)
    assert usual.changes["band"] < 0.05 and "follows" not in usual.evidence
    # Deep in the body the density may go no deeper than in the full model, and a band is as wide as it is deep.
    assert hidden.changes["band_inside"] <= full.band and hidden.changes["band"] <= 0.101 and "follows" in hidden.evidence


def test_nothing_but_training_images_is_looked_at(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: set[tuple[str, int]] = set()
    for name in ("image", "mask"):
        read = getattr(Capture, name)

        def noted(self: Capture, camera: str, frame: int, read: Any = read) -> np.ndarray:
            looked.add((camera, frame))
            return read(self, camera, frame)

        monkeypatch.setattr(Capture, name, noted)
    found = plan(capture)
    assert looked == set(capture.splits["train"])
    assert found.looked_at == {"cameras": list(capture.splits["train"].cameras), "frames": list(capture.splits["train"].frames)}


def test_a_sphere_that_glows_needs_neither_pose_nor_light_nor_view(planned: Plan) -> None:
    preset = planned.preset
    assert (preset.pose_layers, preset.deformation_layers, preset.normal_octaves, preset.direction_octaves) == ((), (), -1, -1)
    full = full_model()
    assert preset.band + preset.band_inside < 0.75 * (full.band + full.band_inside)
    assert {finding.key for finding in planned.findings} >= {"pose", "light", "view", "band", "detail", "scattering"}
    assert all(finding.evidence and finding.follows for finding in planned.findings)


def test_a_part_is_kept_where_it_is_there_beyond_doubt_and_worth_it() -> None:
    settings, full = Settings(accuracy=30, worth=0.1), full_model()
    # 0.1 dB of an error of 1e-3 is 2.33e-5.
    for value, error, kept in ((3e-5, 1e-5, True), (2e-5, 1e-6, False), (1e-4, 6e-5, False)):
        for about in (findings.about_light, findings.about_view):
            finding = about(Estimate(value, error), settings, full)
            assert (not finding.left_out) == kept
    assert findings.about_view(UNTOLD, settings, full).changes == {"direction_octaves": -1, "direction": "view"}
    assert findings.worth(Estimate(1e-3, 0), settings) == pytest.approx(10 * np.log10(2))


def test_the_grid_is_finer_than_a_pixel_and_no_finer_than_a_blur_that_costs_nothing() -> None:
    settings, full = Settings(), full_model()

    def about(texel: float, **lost: float) -> Finding:
        of_blurs = {2: 1.0, 4: 1.0, 8: 1.0} | {int(name[1:]): value for name, value in lost.items()}
        return findings.about_detail(Detail(0.01, 0.02, texel, of_blurs, 1.0, 0.5), settings, full)

    coarse, fine, plain = about(0.01), about(0.0034), about(0.01, _2=0.0)
    # Two thirds of a pixel, within the rounding to whole octets of cells.
    assert 100 < coarse.changes["grid_finest"] <= 158 < 400 < fine.changes["grid_finest"] <= full.grid_finest
    assert plain.changes["grid_finest"] <= 83 and plain.changes["grid_levels"] < coarse.changes["grid_levels"] < full.grid_levels
    assert "0 levels" not in fine.left_out and "level" in coarse.left_out and not about(0.001).left_out


def test_what_one_finding_took_away_can_be_put_back_alone(planned: Plan) -> None:
    full, left_out = full_model(), planned.preset
    network = {"colour_layers", "feature_width"}
    # What enters the colour brings the colour network back: nothing would be made of it otherwise.
    follows = {"pose_layers", "pose_products", "grid_features", "deformation_layers"}
    for key, changed in (("pose", follows | network), ("light", {"normal_octaves"} | network),
                         ("view", {"direction_octaves", "direction"} | network), ("band", {"band", "band_inside"}), ("colour", network)):
        preset = put_back(planned, key)
        different = {field.name for field in dataclasses.fields(Preset) if getattr(preset, field.name) != getattr(left_out, field.name)}
        assert different == changed | {"name"}
        assert all(getattr(preset, name) == getattr(full, name) for name in changed)
    assert put_back(planned, "detail").grid_entries == full.grid_entries
    with pytest.raises(InputError, match="band"):
        put_back(planned, "hair")


def test_parts_left_out_have_no_weights_and_no_operations() -> None:
    full = dataclasses.replace(full_model(), grid_entries=2**10, grid_levels=2)
    sizes, operations = [], []
    for changes in ({}, {"pose_layers": (), "deformation_layers": ()}, {"direction_octaves": -1, "direction": "view"},
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
            operations.append(sum(kernel["operation_count"] for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT))
        sizes.append(field.size)
        assert full.pose_layers or not any(name.startswith(("pose", "deform")) for name in field.layers)
        assert all(layer.pose == 0 for layer in field.layers.values()) or full.pose_layers
    assert sizes == sorted(set(sizes), reverse=True)
    # The last takes no operation away but a layer: what is read off a wider one is unpacked in more of them.
    assert operations[:-1] == sorted(set(operations[:-1]), reverse=True)


def test_a_plan_comes_back_from_disk_and_is_of_one_capture(planned: Plan, capture: Capture, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    planned.write(file)
    preset, value = read_preset(file, capture.digest)
    assert preset == planned.preset and value == json.loads(json.dumps(planned.to_dict()))
    with pytest.raises(InputError, match="digest"):
        read_preset(file, "another")
    with pytest.raises(InputError, match="no such file"):
        read_preset(tmp_path / "none.json", capture.digest)
    for change in ({"format": "x"}, {"version": 9}, {"preset": 3}, {"preset": {"x": 1}}):
        file.write_text(json.dumps(value | change))
        with pytest.raises(InputError, match=next(iter(change))):
            read_preset(file, capture.digest)
    file.write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        read_preset(file, capture.digest)


def test_the_commands_plan_print_and_train(capture: Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.json"
    assert main(["plan", str(capture.path), "-o", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "left out" in printed and "pose features and the deformation net" in printed and str(file) in printed
    for name, model in (("auto", "auto"), ("file", str(file))):
        run = tmp_path / name
        options = ["--steps", "2", "--option", "rays=64", "--option", "samples=16"]
        assert main(["optimise", str(capture.path), "-o", str(run), "--model", model, *options]) == 0
        config = json.loads((run / "config.json").read_text())
        assert config["plan"] == json.loads(file.read_text())
        assert Preset.from_dict(config["preset"]) == Preset.from_dict(config["plan"]["preset"])
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", "auto", "--preset", "paper"]) == 2
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", "none.json"]) == 2
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "x"), "--model", str(file), "--option", "atlas=one-piece"]) == 2
    assert main(["plan", str(capture.path), "--worth", "-1"]) == 2
    assert not (tmp_path / "x").exists()
