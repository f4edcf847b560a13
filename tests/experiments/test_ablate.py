"""The ablation study: trains what is missing, continues where it stopped, and keeps comparable rows;
trainings are faked except in two tests, which train for a few steps."""

from __future__ import annotations

import dataclasses
import json
import shutil

import pytest

from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.experiments.ablate import RESULTS, AblationStudy
from ndf_mi.experiments.core import Progress
from ndf_mi.experiments.records import Measured, MethodResult, Results, View
from ndf_mi.experiments.settings import Evaluation
from ndf_mi.field import preset
from ndf_mi.learn import trained
from ndf_mi.learn.ablations import ABLATIONS
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.methods import ndf
from ndf_mi.reports.ablate import PAPER, agreement, order

OPTIONS = TrainingOptions(surface="body", steps=4, rays=128, samples=24)
MEASURED = Evaluation(max_images=1, sequence=2, samples=16)


def study(capture, folder, names=(), options=OPTIONS, settings=MEASURED):
    return AblationStudy(capture.path, folder, names, preset("tiny"), options, settings, "ndf-mi ablate …")


class Begun(Progress):
    """Keeps the labels of units that were begun; fails at those that are not allowed."""

    def __init__(self, stop=None):
        self.labels, self.stop = [], stop

    def begin(self, unit, number, of, why):
        self.labels.append(unit.label)

    def done(self, unit, number, of):
        if self.stop is not None and self.stop(unit, number):
            raise KeyboardInterrupt

    @property
    def trainings(self):
        return [label for label in self.labels if label.startswith("train ")]


def train_at_once(trainer, *_):
    trainer.run.config["trained"] = {"steps": 4, "seconds": 1.0, "done": True}
    trainer.run.save()


@pytest.fixture
def untrained(monkeypatch):
    """Runs count as trained at once."""
    monkeypatch.setattr(trained, "train", train_at_once)


@pytest.fixture(scope="module")
def studied(capture, tmp_path_factory):
    """A complete study of the full model and the one without pose; not to be changed."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trained, "train", train_at_once)
        study(capture, folder, ("no-pose",)).run()
    return folder


@pytest.fixture
def folder(studied, tmp_path):
    """A copy of that study."""
    return shutil.copytree(studied, tmp_path / "study")


def rows(study):
    return [row.key for row in study.results.methods]


def test_it_trains_each_variant_once_and_continues_within_a_training(capture, tmp_path):
    begun = Begun()
    results = study(capture, tmp_path, ("no-pose",)).run(begun)
    assert begun.trainings == ["train full model", "train without pose"]
    assert [method.key for method in results.methods] == ["full", "no-pose"]
    begun = Begun()
    assert study(capture, tmp_path, ("no-pose",)).run(begun).methods == results.methods and begun.labels == []
    # A training that was stopped: its state is there, but it has not ended, and the record of its end is
    # gone.
    config = json.loads((tmp_path / "no-pose" / "config.json").read_text())
    del config["trained"]
    (tmp_path / "no-pose" / "config.json").write_text(json.dumps(config))
    spoil(tmp_path, lambda document: document["records"].pop("no-pose/train"))
    begun = Begun()
    study(capture, tmp_path, ("no-pose",)).run(begun)
    assert begun.trainings == ["train without pose"]
    assert json.loads((tmp_path / "no-pose" / "config.json").read_text())["trained"]["steps"] == OPTIONS.steps


def test_rows_that_were_measured_otherwise_are_not_kept_beside_new_ones(capture, folder, untrained):
    fewer = study(capture, folder, settings=dataclasses.replace(MEASURED, max_images=2))
    assert rows(fewer) == []
    assert [row.key for row in fewer.run().methods] == ["full"]
    # Its images are still there, and it comes back without work.
    begun = Begun()
    again = study(capture, folder)
    assert rows(again) == ["full", "no-pose"]
    again.run(begun)
    assert begun.labels == [] and rows(again) == ["full", "no-pose"]


@pytest.mark.parametrize(
    "stop",
    [
        lambda unit, number: unit.record is Measured and "without pose" in unit.label and number == 1,
        lambda unit, number: unit.key.startswith("no-pose/train"),
    ],
)
def test_a_row_whose_measuring_was_stopped_is_not_shown_until_it_is_complete(
    capture, tmp_path, untrained, stop
):
    with pytest.raises(KeyboardInterrupt):
        study(capture, tmp_path, ("no-pose",)).run(Begun(stop))
    assert [row.key for row in study(capture, tmp_path, ("surface-point",)).run().methods] == [
        "full", "surface-point",
    ]
    again = study(capture, tmp_path, ("no-pose",)).run().methods
    assert [row.key for row in again] == ["full", "no-pose", "surface-point"]
    assert len({len(row.images) for row in again}) == 1


def spoil(folder, change):
    document = json.loads((folder / RESULTS).read_text())
    change(document)
    (folder / RESULTS).write_text(json.dumps(document))


@pytest.mark.parametrize("what", ["capture", "renderer", "weights", "variant", "sequence"])
def test_rows_of_another_capture_renderer_or_training_are_not_kept(
    capture, folder, monkeypatch, what
):
    assert rows(study(capture, folder)) == ["full", "no-pose"]
    if what in ("capture", "sequence"):
        other = {"capture": ("image", {"capture": "0" * 64}), "sequence": ("flicker", {"frames": [1, 2]})}[
            what
        ]

        def change(document):
            for key, record in document["records"].items():
                record["inputs"].update(other[1] if key.startswith(f"no-pose/{other[0]}") else {})

        spoil(folder, change)
    elif what == "renderer":
        monkeypatch.setattr(ndf, "RECIPE", "another")
    elif what == "variant":
        monkeypatch.setitem(
            ABLATIONS, "no-pose", dataclasses.replace(ABLATIONS["no-pose"], training={"pose_noise": 0.0})
        )
    else:
        for file in ("config.json", "field.safetensors"):
            (folder / "no-pose" / file).write_bytes((folder / "full" / file).read_bytes())
    assert "no-pose" not in rows(study(capture, folder))


def test_studies_older_than_an_option_continue(capture, tmp_path, untrained):
    """Runs without an entry were trained at its former value: without noise on the pose, and with today's
    architecture.
    """
    quiet = dataclasses.replace(OPTIONS, pose_noise=0.0)
    study(capture, tmp_path, ("no-pose",), quiet).run()
    for name in ("full", "no-pose"):
        file = tmp_path / name / "config.json"
        config = json.loads(file.read_text())
        del config["training"]["pose_noise"]
        file.write_text(json.dumps(config))
    assert rows(study(capture, tmp_path, options=quiet)) == ["full", "no-pose"]
    with pytest.raises(InputError, match="pose_noise = 0.0; expected pose_noise = 0.1"):
        study(capture, tmp_path)


def test_other_options_are_refused_by_name(capture, folder):
    with pytest.raises(InputError, match="rays = 128"):
        study(capture, folder, options=TrainingOptions(surface="body", steps=4, rays=64, samples=24))
    config = json.loads((folder / "full" / "config.json").read_text())
    del config["training"]
    (folder / "full" / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="training"):
        study(capture, folder)


def result(key, view, pose):
    images = [
        Measured(View(split, "0", 0), 1.0, {"box_psnr": value})
        for split, value in (("novel_view", view), ("novel_pose", pose))
    ]
    return MethodResult(key, key, "", {}, images)


def test_agreement_is_of_directions():
    results = Results(
        {},
        [
            result("full", 30.0, 25.0), result("naked", 29.0, 26.0), result("no-deform", 29.9, 24.0),
            result("unsigned", 20.0, 20.0),
        ],
    )
    found = agreement(results, "naked", "novel_view")
    assert (
        found is not None
        and found.here == pytest.approx(-1.0)
        and found.paper == pytest.approx(-6.10)
        and found.agrees
    )
    assert not agreement(results, "naked", "novel_pose").agrees
    # The paper has 0.03 and 0.06 dB between them, which is level.
    assert (
        agreement(results, "no-deform", "novel_view").agrees
        and not agreement(results, "no-deform", "novel_pose").agrees
    )
    # In the paper, naked differs from the two others, which are level; here it is behind them, and on novel
    # poses ahead.
    assert order(results, "novel_view") == (2, 2) and order(results, "novel_pose") == (0, 2)
    # The paper has no such row.
    assert (
        agreement(results, "unsigned", "novel_view") is None
        and agreement(results, "full", "novel_view") is None
    )
    assert set(PAPER) == {"full", "naked", "no-pose", "no-projection", "no-deform", "one-piece"}


def test_the_command_trains_measures_and_writes_the_report(capture, tmp_path, capsys):
    out = tmp_path / "study"
    arguments = [
        "ablate", str(capture.path), "-o", str(out), "--only", "no-deform", "--preset", "tiny", "--steps",
        "3", "--max-images", "1", "--sequence", "0", "--samples", "16", "--option", "rays=96", "--option",
        "feature_width=4",
    ]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert (
        "without deformation" in printed.out
        and "report.html" in printed.out
        and "train full model" in printed.err
    )
    assert [method["key"] for method in json.loads((out / RESULTS).read_text())["methods"]] == [
        "full", "no-deform",
    ]
    for name in ("full", "no-deform"):
        config = json.loads((out / name / "config.json").read_text())
        assert (
            config["training"]["rays"] == 96
            and config["preset"]["feature_width"] == 4
            and config["training"]["steps"] == 3
        )
    page = (out / "report.html").read_text()
    assert "default" in page and page.count("<img") >= 4 and (out / "table.md").is_file()


def test_mistakes_leave_with_exit_code_2(capture, tmp_path, capsys):
    arguments = ["ablate", str(capture.path), "-o", str(tmp_path / "out")]
    for more, words in (
        (["--only", "no-light"], "no-projection"), (["--option", "ray=3"], "band"),
        (["--samples", "0"], "samples"), (["--protocol", "zju"], "at least 60"),
    ):
        assert main([*arguments, *more]) == 2
        assert words in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_settings_take_the_protocols_number_of_images():
    assert Evaluation().to_dict()["max_images"] == 48
    assert Evaluation(protocol="zju").to_dict()["max_images"] is None
    with pytest.raises(InputError, match="option protocol"):
        Evaluation(protocol="human36m")
