"""The ablation study: trains what is missing, goes on where it was, and says of each row whether it agrees with the paper."""

import dataclasses
import json

import pytest

from ndf_mi.commands import main
from ndf_mi.commands.ablate import Ablate
from ndf_mi.errors import InputError
from ndf_mi.experiments import protocols
from ndf_mi.experiments.ablate import RESULTS, Settings, Study
from ndf_mi.experiments.records import Measured, MethodResult, Results, View
from ndf_mi.experiments.trained import expect_options
from ndf_mi.field import preset
from ndf_mi.learn import loop
from ndf_mi.learn.ablations import ABLATIONS
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.methods import ndf
from ndf_mi.reports.ablate import PAPER, agreement, markdown, order

OPTIONS = TrainingOptions(steps=4, rays=128, samples=24)
NAMES = ("no-pose", "surface-point")


def study(capture, folder, names=NAMES, options=OPTIONS):
    return Study(capture.path, folder, names, preset("tiny"), options, Settings(max_images=2, sequence=2, samples=32), "ndf-mi ablate …")


@pytest.mark.long
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


def silent(*_):
    """Listens to nothing."""


def test_a_row_whose_measuring_was_stopped_is_not_kept(capture, tmp_path):
    """Its means would be over other images than those of the rows beside it."""
    def stop(title, done, of):
        if title == "without pose" and done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study(capture, tmp_path, ("no-pose",)).run(silent, stop)
    rows = study(capture, tmp_path, ("surface-point",)).run(silent, silent).methods
    assert [row.key for row in rows] == ["full", "surface-point"]
    # Named again, it goes on where it was, and then stays beside others.
    again = study(capture, tmp_path, ("no-pose",)).run(lambda *_: pytest.fail("trained again"), silent).methods
    assert [row.key for row in again] == ["full", "no-pose", "surface-point"]
    assert len({len(row.images) for row in again}) == 1


def test_a_row_that_was_stopped_before_its_sequences_is_not_kept(capture, tmp_path):
    study(capture, tmp_path, ("no-pose",)).run(silent, silent)
    spoil(tmp_path, lambda document: document["methods"][1].update(flicker=[]))
    assert [row.key for row in study(capture, tmp_path, ()).results.methods] == ["full"]


def spoil(folder, change):
    document = json.loads((folder / RESULTS).read_text())
    change(document)
    (folder / RESULTS).write_text(json.dumps(document))


@pytest.mark.parametrize("what", ["capture", "renderer", "weights", "variant"])
def test_rows_of_another_capture_renderer_or_training_are_not_kept(capture, tmp_path, monkeypatch, what):
    study(capture, tmp_path, ("no-pose",)).run(silent, silent)
    assert [row.key for row in study(capture, tmp_path, ()).results.methods] == ["full", "no-pose"]
    if what == "capture":
        spoil(tmp_path, lambda document: document["capture"].update(digest="0" * 64))
    elif what == "renderer":
        monkeypatch.setattr(ndf, "RECIPE", "another")
    elif what == "variant":
        monkeypatch.setitem(ABLATIONS, "no-pose", dataclasses.replace(ABLATIONS["no-pose"], training={"pose_noise": 0.0}))
    else:
        for file in ("config.json", "field.safetensors"):
            (tmp_path / "no-pose" / file).write_bytes((tmp_path / "full" / file).read_bytes())
    assert "no-pose" not in [row.key for row in study(capture, tmp_path, ()).results.methods]


def test_studies_from_before_an_option_existed_go_on(capture, tmp_path):
    """Runs without an entry were trained at its value of then: without noise on the pose, and with today's architecture."""
    quiet = dataclasses.replace(OPTIONS, pose_noise=0.0)
    study(capture, tmp_path, ("no-pose",), quiet).run(silent, silent)
    for name in ("full", "no-pose"):
        file = tmp_path / name / "config.json"
        config = json.loads(file.read_text())
        del config["training"]["pose_noise"]
        if name == "full":
            del config["preset"]["density_skip"]
        file.write_text(json.dumps(config))

    def age(document):
        del document["training"]["pose_noise"], document["settings"]["protocol"], document["protocol"]

    spoil(tmp_path, age)
    assert "no-pose" in [row.key for row in study(capture, tmp_path, (), quiet).results.methods]
    with pytest.raises(InputError, match="pose_noise = 0.0; expected 0.1"):
        study(capture, tmp_path, (), OPTIONS)


@pytest.mark.parametrize("products", [True, False])
def test_an_option_that_older_presets_lack_is_told_apart_both_ways(capture, tmp_path, products):
    with_, without = (dataclasses.replace(preset("tiny"), pose_products=value) for value in (products, not products))
    run = loop.start(tmp_path / "run", capture, with_, OPTIONS).run
    expect_options(run, capture, with_, OPTIONS)
    with pytest.raises(InputError, match=f"pose_products = {products}; expected {not products}"):
        expect_options(run, capture, without, OPTIONS)


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


def test_options_and_protocols_of_the_command(capture, tmp_path, capsys):
    arguments = ["ablate", str(capture.path), "-o", str(tmp_path / "study"), "--only", "no-deform", "--preset", "tiny", "--steps", "3",
                 "--max-images", "1", "--sequence", "0", "--samples", "16", "--option", "rays=96", "--option", "feature_width=4"]
    assert main(arguments) == 0
    capsys.readouterr()
    for name in ("full", "no-deform"):
        config = json.loads((tmp_path / "study" / name / "config.json").read_text())
        assert config["training"]["rays"] == 96 and config["preset"]["feature_width"] == 4 and config["training"]["steps"] == 3
    assert "Protocol ours" in (tmp_path / "study" / "report.html").read_text()
    assert main([*arguments, "--option", "ray=3"]) == 2
    assert "NAME one of atlas, band" in capsys.readouterr().err
    # The capture of a few frames is none of the publication's.
    assert main([*arguments[:3], str(tmp_path / "zju"), "--protocol", "zju"]) == 2
    assert "at least 60, for protocol zju" in capsys.readouterr().err and not (tmp_path / "zju").exists()
    command = Ablate(tmp_path, tmp_path / "out", option=("rays=96", "band=0.12"), protocol="zju")
    assert command._arguments()[4:] == ["--option", "rays=96", "--option", "band=0.12", "--protocol", "zju"]


def test_settings_take_the_protocols_number_of_images():
    assert Settings().to_dict()["max_images"] == protocols.OURS.max_images == 48
    assert Settings(protocol="zju").to_dict()["max_images"] is None
    with pytest.raises(InputError, match="option protocol"):
        Settings(protocol="human36m")
