"""The ablation study: trains what is missing, goes on where it was, and says of each row whether it agrees with the paper."""

import json

import pytest

from ndf_mi.commands import main
from ndf_mi.compare.ablation import RESULTS, Settings, Study
from ndf_mi.compare.ablation_report import PAPER, agreement, markdown, order
from ndf_mi.compare.results import Measured, MethodResult, Results, View
from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn import loop
from ndf_mi.learn.options import TrainingOptions

OPTIONS = TrainingOptions(steps=4, rays=128, samples=24)
NAMES = ("no-pose", "surface-point")


def study(capture, folder, names=NAMES, options=OPTIONS):
    return Study(capture.path, folder, names, preset("tiny"), options, Settings(max_images=2, sequence=2, samples=32), "ndf-mi ablate …")


def test_trains_each_once_and_goes_on_where_it_was(capture, tmp_path, monkeypatch):
    begun = []
    results = study(capture, tmp_path).run(lambda name, number, of: begun.append((name, number, of)), lambda *_: None)
    assert begun == [("full", 1, 3), ("no-pose", 2, 3), ("surface-point", 3, 3)]
    assert [method.key for method in results.methods] == ["full", "no-pose", "surface-point"]
    page = (tmp_path / "report.html").read_text()
    assert "surface point" in page and page.count("<img") >= 4
    assert (tmp_path / "table.md").read_text() == markdown(results)

    # All is there: nothing is trained or rendered again.
    monkeypatch.setattr(loop, "train", None)
    again = study(capture, tmp_path).run(lambda *_: pytest.fail("trained again"), lambda *_: pytest.fail("measured again"))
    assert markdown(again) == markdown(results)


def test_a_stopped_training_is_resumed_and_an_unstarted_one_begun_anew(capture, tmp_path):
    first = study(capture, tmp_path, ("no-pose",))
    first.run(lambda *_: None, lambda *_: None)
    config = json.loads((tmp_path / "no-pose" / "config.json").read_text())
    del config["trained"]
    (tmp_path / "no-pose" / "config.json").write_text(json.dumps(config))
    begun = []
    study(capture, tmp_path, ("no-pose",)).run(lambda name, *_: begun.append(name), lambda *_: None)
    assert begun == ["no-pose"]
    assert json.loads((tmp_path / "no-pose" / "config.json").read_text())["trained"]["steps"] == OPTIONS.steps
    (tmp_path / "no-pose" / "state.safetensors").unlink()
    del config["training"]
    with pytest.raises(InputError, match="training"):
        (tmp_path / "no-pose" / "config.json").write_text(json.dumps(config))
        study(capture, tmp_path, ("no-pose",))


def test_rows_measured_otherwise_are_not_kept_beside_new_ones(capture, tmp_path):
    study(capture, tmp_path, ("no-pose",)).run(lambda *_: None, lambda *_: None)
    fewer = Study(capture.path, tmp_path, (), preset("tiny"), OPTIONS, Settings(max_images=1, sequence=0, samples=32), "…")
    assert [method.key for method in fewer.run(lambda *_: pytest.fail("trained again"), lambda *_: None).methods] == ["full"]
    # The images of the row left out are still there, and it comes back without being trained.
    again = study(capture, tmp_path, ("no-pose",)).run(lambda *_: pytest.fail("trained again"), lambda *_: None)
    assert [method.key for method in again.methods] == ["full", "no-pose"]


def test_other_options_are_refused_by_name(capture, tmp_path):
    study(capture, tmp_path, ()).run(lambda *_: None, lambda *_: None)
    with pytest.raises(InputError, match="rays = 128"):
        study(capture, tmp_path, (), TrainingOptions(steps=4, rays=64, samples=24))


def result(key, view, pose):
    images = [Measured(View(split, "0", 0), 1.0, {"box_psnr": value}) for split, value in (("novel_view", view), ("novel_pose", pose))]
    return MethodResult(key, key, "", {}, images)


def test_agreement_is_of_directions():
    results = Results({}, [result("full", 30.0, 25.0), result("naked", 29.0, 26.0), result("no-deform", 29.9, 24.0),
                           result("unsigned", 20.0, 20.0)])
    found = agreement(results, "naked", "novel_view")
    assert found is not None and found.here == pytest.approx(-1.0) and found.paper == pytest.approx(-6.10) and found.agrees
    assert not agreement(results, "naked", "novel_pose").agrees
    # The paper has 0.03 and 0.06 dB between them, which is level.
    assert agreement(results, "no-deform", "novel_view").agrees and not agreement(results, "no-deform", "novel_pose").agrees
    # The paper tells naked apart from the two others, which are level; here it is behind them, and on novel poses ahead.
    assert order(results, "novel_view") == (2, 2) and order(results, "novel_pose") == (0, 2)
    # The paper has no such row.
    assert agreement(results, "unsigned", "novel_view") is None and agreement(results, "full", "novel_view") is None
    assert set(PAPER) == {"full", "naked", "no-pose", "no-projection", "no-deform", "one-piece"}


def test_command(capture, tmp_path, capsys):
    arguments = ["ablate", str(capture.path), "-o", str(tmp_path / "study"), "--only", "no-deform", "--preset", "tiny", "--steps", "3",
                 "--max-images", "1", "--sequence", "0", "--samples", "16"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "without deformation" in out and "report.html" in out
    results = json.loads((tmp_path / "study" / RESULTS).read_text())
    assert [method["key"] for method in results["methods"]] == ["full", "no-deform"]
    assert main([*arguments[:4], "--only", "no-light"]) == 2
    assert "no-projection" in capsys.readouterr().err
