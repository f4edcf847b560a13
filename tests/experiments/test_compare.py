"""Comparisons: which methods are trained for how long, what is kept, and what the report shows; mostly of toy
methods.
"""

from __future__ import annotations

import functools
import json
import math
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.images import write_image
from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.compare import RESULTS, Comparison, Settings
from ndf_mi.experiments.core import SILENT, Progress
from ndf_mi.field import PRESETS
from ndf_mi.methods import registry
from ndf_mi.methods.ndf import NeuralField
from ndf_mi.run import Run

RUN_SECONDS = 3600.0


class Brighter:
    """The truth plus a constant. Counts what it does, for all of its instances."""

    key, label = "brighter", "Brighter"
    seconds_to_converge = 5.0
    fits: list[tuple[float | None, int, int, float | None]]
    renders: list[tuple[str, int]]

    def __init__(self, texture=512, rate=None):
        self._texture, self._rate = texture, rate

    def fit(self, capture, budget, progress=None):
        self.fits.append((budget.seconds, budget.seed, self._texture, self._rate))
        progress(1.0, 10, 0.01)
        self._take(capture, {"budget": budget.seconds, "seed": budget.seed})

    def save(self, folder):
        files.write_json(Path(folder) / "brighter.json", self._known)

    def load(self, folder, capture):
        self._take(capture, json.loads((Path(folder) / "brighter.json").read_text()))

    def _take(self, capture, known):
        self._capture, self._known = capture, known

    def render(self, camera, frame):
        self.renders.append((camera.name, frame))
        return self._capture.image(camera.name, frame) + np.float32(0.1)

    def metadata(self):
        seconds = self._known["budget"] or self.seconds_to_converge
        return {
            **self._known, "seconds": seconds, "steps": 10, "converged": self._known["budget"] is None,
            "tuned": {"rate": 0.5},
        }

    def cache_key(self):
        return f"brighter {self._known} {self._capture.digest}"


@pytest.fixture
def brighter(monkeypatch):
    monkeypatch.setattr(Brighter, "fits", [], raising=False)
    monkeypatch.setattr(Brighter, "renders", [], raising=False)
    registry.register(Brighter)
    yield Brighter
    registry.unregister(Brighter.key)


@pytest.fixture(scope="module")
def run(capture, tmp_path_factory):
    """An untrained field that claims an hour of training on the capture."""
    path = tmp_path_factory.mktemp("run")
    made = Run.create(
        path, PRESETS["tiny"], capture.body, capture.poses, seed=0, background=capture.background.tolist(),
        capture={"name": capture.name, "digest": capture.digest},
        trained={"steps": 10, "seconds": RUN_SECONDS, "done": True},
    )
    made.save()
    return path


def settings(*methods: str, **more) -> Settings:
    return Settings(**{"max_images": 1, "texture": 32, "samples": 16, "sequence": 0, **more}, methods=methods)


def compared(run, capture, folder, *methods: str, progress=SILENT, **more):
    return Comparison(run, capture.path, folder, settings(*methods, **more), "ndf-mi compare …").run(progress)


def keys(results) -> list[str]:
    return [method.key for method in results.methods]


class TinyField(NeuralField):
    key, label = "tiny-field", "Tiny field"

    def __init__(self, samples=16):
        super().__init__(samples, "tiny")


@pytest.mark.long
def test_a_stopped_training_of_a_field_continues_and_is_recorded(run, capture, tmp_path):
    class Stop(Progress):
        def __init__(self, last):
            self.steps, self.last = [], last

        def training(self, label, seconds, budget, step, loss):
            self.steps.append(step)
            if step == self.last:
                signal.raise_signal(signal.SIGINT)

    registry.register(TinyField)
    try:
        first, second, third = Stop(2), Stop(None), Stop(None)
        # Time enough to compile the kernels of two steps on a slow machine.
        again = functools.partial(compared, run, capture, tmp_path, "tiny-field@equal-time", seconds=15)
        with pytest.raises(KeyboardInterrupt):
            again(progress=first)
        results = again(progress=second)
        again(progress=third)
    finally:
        registry.unregister("tiny-field")
    assert first.steps == [1, 2] and second.steps[0] == 3 and third.steps == []
    assert results.methods[0].metadata["steps"] == second.steps[-1]


def test_a_new_method_appears_in_tables_pictures_and_report_with_no_other_file_touched(
    run, capture, tmp_path, capsys
):
    class Grey:
        key, label = "grey", "Plain grey"

        def fit(self, capture, budget, progress=None):
            self._size = 0.5

        def render(self, camera, frame):
            return np.full((camera.h, camera.w, 3), self._size, np.float32)

        def metadata(self):
            return {"seconds": 1.0}

        def cache_key(self):
            return "grey"

        def save(self, folder):
            files.write_text(Path(folder) / "grey.txt", "")

        def load(self, folder, capture):
            self._size = 0.5

    registry.register(Grey)
    try:
        out = tmp_path / "out"
        arguments = [
            "compare", str(run), "--capture", str(capture.path), "-o", str(out), "--max-images", "1",
            "--samples", "16",
        ]
        assert main([*arguments, "--sequence", "2", "--methods", "ndf,grey@converged"]) == 0
    finally:
        registry.unregister("grey")
    assert "Plain grey" in capsys.readouterr().out
    page = (out / "report.html").read_text()
    assert "Plain grey" in page and page.count("data:image/png") >= 3 * 3
    methods = {method["key"]: method for method in json.loads((out / RESULTS).read_text())["methods"]}
    assert list(methods) == ["ndf", "grey-converged"]
    assert set(methods["grey-converged"]["means"]["novel_pose"]) == set(metrics.LABELS)
    with Image.open(next((out / "compare" / "pictures" / "grey-converged").rglob("*.png"))) as picture:
        assert set(np.asarray(picture).ravel()) == {128}


def test_without_a_budget_a_method_is_trained_to_convergence_and_for_equal_time_if_that_differs(
    run, capture, tmp_path, brighter, monkeypatch
):
    # Converged within the run's hour: one training stands for both.
    first = compared(run, capture, tmp_path, "ndf", "brighter")
    assert keys(first) == ["ndf", "brighter-converged"] and brighter.fits == [(None, 0, 32, None)]
    assert first.methods[1].label == "Brighter, to convergence"
    # For a time that the user gave it is trained for that time alone.
    timed = compared(run, capture, tmp_path, "ndf", "brighter", seconds=0.5)
    assert keys(timed) == ["ndf", "brighter-equal-time"] and brighter.fits[1:] == [(0.5, 0, 32, None)]
    # Slower than the run.
    monkeypatch.setattr(brighter, "seconds_to_converge", 2 * RUN_SECONDS)
    slow = compared(run, capture, tmp_path / "slow", "brighter")
    assert keys(slow) == ["brighter-equal-time", "brighter-converged"] and brighter.fits[-1][0] == RUN_SECONDS


def test_what_a_search_found_does_not_reach_other_methods(run, capture, tmp_path, brighter):
    class Foreign(Brighter):
        key = "foreign"

    registry.register(Foreign)
    try:
        compared(run, capture, tmp_path, "brighter", "foreign", seconds=0.5, seeds=2)
    finally:
        registry.unregister("foreign")
    assert [rate for *_, rate in brighter.fits] == [None, 0.5, None, 0.5]


def test_several_seeds_are_trainings_of_one_method(run, capture, tmp_path, brighter):
    found = compared(run, capture, tmp_path, "ndf", "brighter", seconds=0.5, seeds=3, seed=4)
    assert [seed for _, seed, *_ in brighter.fits] == [4, 5, 6]
    assert keys(found) == ["ndf", "brighter-equal-time", "brighter-equal-time-seed5",
                           "brighter-equal-time-seed6"]
    field, others = found.trainings()
    assert len(field.members) == 1 and len(others.members) == 3 and others.label == "Brighter, equal time"
    assert field.spread("novel_view", "box_psnr") is None
    assert others.spread("novel_view", "box_psnr") == pytest.approx(0, abs=1e-9)
    assert keys(found.first()) == keys(found)[:2]
    # One seed more: the others are there already.
    compared(run, capture, tmp_path, "ndf", "brighter", seconds=0.5, seeds=4, seed=4)
    assert [seed for _, seed, *_ in brighter.fits] == [4, 5, 6, 7]


def test_without_a_run_all_methods_are_trained(capture, tmp_path, brighter, capsys):
    arguments = ["compare", str(capture.path), "--methods", "brighter,images:x", "--max-images", "1"]
    assert main(arguments) == 2 and "-o" in capsys.readouterr().err
    arguments = ["compare", str(capture.path), "-o", str(tmp_path / "out"), "--methods", "brighter",
                 "--max-images", "1", "--sequence", "0"]
    assert main(arguments) == 2 and "--seconds" in capsys.readouterr().err
    assert not (tmp_path / "out").exists() and not brighter.fits
    assert main([*arguments, "--capture", str(capture.path), "--seconds", "1"]) == 2
    assert main([*arguments, "--seconds", "1", "--seeds", "2"]) == 0
    assert [fit[:2] for fit in brighter.fits] == [(1.0, 0), (1.0, 1)] and "±" in capsys.readouterr().out
    document = json.loads((tmp_path / "out" / RESULTS).read_text())
    assert document["about"]["run"] is None
    (first, second) = document["methods"]
    size = (tmp_path / "out" / "compare" / "brighter-equal-time" / "brighter.json").stat().st_size
    assert first["metadata"]["size_on_disk"] == size
    # A process with Mitsuba in it.
    assert first["metadata"]["peak_memory"] > 1e8


def test_a_run_needs_its_capture(run, tmp_path, capsys):
    assert main(["compare", str(run), "-o", str(tmp_path)]) == 2 and "--capture" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spec", "expected", "seconds"),
    [
        ("brighter@converged", "brighter-converged", None),
        ("brighter@equal-time", "brighter-equal-time", RUN_SECONDS),
    ],
)
def test_a_budget_is_followed(run, capture, tmp_path, brighter, spec, expected, seconds):
    assert keys(compared(run, capture, tmp_path, spec)) == [expected]
    assert [fit[0] for fit in brighter.fits] == [seconds]


def test_what_is_there_is_neither_trained_nor_rendered_again(run, capture, tmp_path, brighter):
    first = compared(run, capture, tmp_path, "ndf", "brighter", sequence=2)
    done = len(brighter.fits), len(brighter.renders)

    class Never(Progress):
        def begin(self, unit, number, of, why):
            pytest.fail(f"did {unit.key} again")

    again = compared(run, capture, tmp_path, "ndf", "brighter", sequence=2, progress=Never())
    assert again.methods == first.methods and (len(brighter.fits), len(brighter.renders)) == done
    # More images: only those that are missing are rendered. Other settings of training: it is trained again.
    compared(run, capture, tmp_path, "brighter", sequence=2, max_images=2)
    assert (
        len(brighter.fits) == done[0]
        and len(brighter.renders) > done[1]
        and len(set(brighter.renders)) == len(brighter.renders)
    )
    compared(run, capture, tmp_path, "brighter", texture=16)
    assert [fit[2] for fit in brighter.fits] == [32, 16]
    # Fewer methods: the others' records stay.
    assert keys(compared(run, capture, tmp_path, "ndf", progress=Never())) == ["ndf"]
    assert keys(compared(run, capture, tmp_path, "ndf", "brighter", texture=16, progress=Never())) == [
        "ndf", "brighter-converged",
    ]


def test_an_interrupted_comparison_continues(run, capture, tmp_path, brighter):
    class Interrupting(Progress):
        def done(self, unit, number, of):
            if unit.record.__name__ == "Measured" and number == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compared(run, capture, tmp_path, "brighter", progress=Interrupting())
    assert len(brighter.renders) == 2
    results = compared(run, capture, tmp_path, "brighter")
    assert len(brighter.fits) == 1 and len(brighter.renders) == len(results.methods[0].images) == 3


def test_images_of_another_program_are_measured(run, capture, tmp_path):
    pictures = tmp_path / "theirs"
    for camera, frame in [pair for split in capture.splits.values() for pair in split]:
        (pictures / camera).mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.round(capture.image(camera, frame) * 255).astype(np.uint8)).save(
            pictures / camera / f"{frame:06d}.png"
        )
    results = compared(run, capture, tmp_path / "out", "ndf", f"images:{pictures}")
    assert keys(results) == ["ndf", "images-theirs"] and results.methods[1].label == "theirs"
    assert results.methods[1].mean("novel_view", "box_psnr") > 50
    # A missing picture is reported before anything is measured.
    for picture in (pictures / "n0").iterdir():
        picture.unlink()
    with pytest.raises(InputError, match="n0"):
        Comparison(
            run, capture.path, tmp_path / "other", settings("ndf", f"images:{pictures}", max_images=9), ""
        )
    assert not (tmp_path / "other").exists()


def test_real_methods_by_the_command_line(run, capture, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = [
        "compare", str(run), "--capture", str(capture.path), "-o", str(out), "--max-images", "1", "--texture",
        "16", "--samples", "16", "--seconds", "0.3", "--methods", "ndf,mesh@equal-time",
    ]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "Mesh, equal time" in printed and "Box PSNR" in printed and str(out / "report.html") in printed
    document = json.loads((out / RESULTS).read_text())
    assert (
        document["about"]["command"].startswith("ndf-mi compare")
        and "--seconds 0.3" in document["about"]["command"]
    )
    field, mesh = document["methods"]
    assert (
        mesh["metadata"]["budget"] == 0.3
        and mesh["means"]["novel_view"]["box_psnr"] > field["means"]["novel_view"]["box_psnr"]
    )


def test_pictures_of_another_program_are_measured(run, capture, tmp_path):
    views = dict.fromkeys(view for split in capture.splits.values() for view in split)
    for camera, frame in views:
        write_image(tmp_path / "theirs" / camera / f"{frame}.png", capture.image(camera, frame))
    theirs = f"images:{tmp_path / 'theirs'}"
    (method,) = compared(run, capture, tmp_path, theirs).methods
    assert (method.key, method.label) == ("images-theirs", "theirs")
    assert method.mean("novel_view", "box_psnr") == math.inf
    (tmp_path / "theirs" / "n0" / "2.png").unlink()
    with pytest.raises(InputError, match="n0/000002.png"):
        compared(run, capture, tmp_path / "again", theirs, max_images=10)


@pytest.mark.parametrize("value", ["none", "equal-time", "some"])
def test_the_old_option_for_offsets_warns(run, capture, tmp_path, capsys, value):
    arguments = [
        "compare", str(run), "--capture", str(capture.path), "-o", str(tmp_path / "out"), "--offsets", value,
    ]
    # The number of images is refused, so that nothing is compared.
    assert main([*arguments, "--max-images", "0"]) == 2
    text = capsys.readouterr().err
    assert "--methods" in text and "deprecated" in text and ("max-images" in text) == (value != "some")


def test_another_capture_is_refused(run, write_capture, tmp_path):
    with pytest.raises(InputError, match="trained on"):
        Comparison(run, write_capture("other"), tmp_path, settings("ndf"), "")
    assert not any(tmp_path.iterdir())


def test_a_run_without_training_time_needs_the_option(run, capture, tmp_path, brighter):
    shutil.copytree(run, tmp_path / "run")
    config = json.loads((run / "config.json").read_text())
    del config["trained"]
    files.write_json(tmp_path / "run" / "config.json", config)
    with pytest.raises(InputError, match="--seconds"):
        Comparison(tmp_path / "run", capture.path, tmp_path, settings("ndf", "brighter"), "")
    for one in (
        settings("ndf", "brighter", seconds=1.0), settings("ndf", "brighter@converged"), settings("ndf"),
    ):
        Comparison(tmp_path / "run", capture.path, tmp_path, one, "")


def test_a_run_that_went_on_for_a_moment_keeps_equal_time_trainings(run, capture, tmp_path, brighter):
    shutil.copytree(run, tmp_path / "run")
    config = json.loads((run / "config.json").read_text())

    def trained_for(of_run, **given):
        files.write_json(
            tmp_path / "run" / "config.json", {**config, "trained": {**config["trained"], "seconds": of_run}}
        )
        before = len(brighter.fits)
        compared(tmp_path / "run", capture, tmp_path, "brighter@equal-time", **given)
        return [fit[0] for fit in brighter.fits[before:]]

    assert trained_for(0.5) == [0.5]
    assert trained_for(0.504) == []
    assert trained_for(0.504, seconds=0.504) == [0.504]
    assert trained_for(0.6) == [0.6]


@pytest.mark.parametrize(
    "option",
    [
        {"max_images": 0}, {"texture": 0}, {"samples": -1}, {"seconds": 0.0},
        {"seconds": float("inf")}, {"seeds": 0}, {"seed": -1}, {"sequence": 1}, {"sequence": -1},
        {"protocol": "some"},
        {"methods": ("some",)}, {"methods": ("ndf", "ndf")},
    ],
)
def test_settings_are_checked(option):
    with pytest.raises(InputError, match=next(iter(option)).replace("_", "-").rstrip("s")):
        Settings(**option)


def test_mistakes_leave_with_exit_code_2_and_nothing_written(run, capture, tmp_path, capsys):
    out = tmp_path / "out"
    for arguments, words in (
        ([str(tmp_path / "absent"), "--capture", str(capture.path)], ["absent"]),
        ([str(run), "--capture", str(capture.path), "--methods", "ndf,nerf"], ["nerf", "offset-mesh"]),
        (
            [str(run), "--capture", str(capture.path), "--methods", f"ndf,images:{tmp_path / 'nowhere'}"],
            ["nowhere"],
        ),
    ):
        assert main(["compare", *arguments, "-o", str(out)]) == 2
        text = capsys.readouterr().err
        assert all(word in text for word in [*words, "expected"]) and "Traceback" not in text
    assert not out.exists()


def test_a_split_of_successive_frames_is_measured(run, capture, tmp_path):
    folder, own = tmp_path / "capture", tmp_path / "run"
    shutil.copytree(capture.path, folder)
    shutil.copytree(run, own)
    document = json.loads((folder / "capture.json").read_text())
    document["splits"]["sequence"] = {"cameras": ["n0"], "frames": [2, 5, 7]}
    (folder / "capture.json").write_text(json.dumps(document))
    config = json.loads((own / "config.json").read_text())
    config["capture"]["digest"] = Capture.read(folder).digest
    (own / "config.json").write_text(json.dumps(config))
    results = Comparison(own, folder, tmp_path / "out", replace(settings("ndf"), sequence=3), "").run()
    assert results.about["measured"] == {"novel_view": 1, "novel_pose": 1, "sequence": 3, "train": 1}
    field = results.methods[0]
    assert field.mean("sequence", "box_psnr") is not None and field.mean("sequence", "box_tpsnr") is not None
    assert field.mean("novel_view", "box_tpsnr") is None
