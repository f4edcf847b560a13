"""Studies on disk: what is read back, what is refused, and files of version 1."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from ndf_mi.errors import InputError
from ndf_mi.experiments.core import Unit
from ndf_mi.experiments.records import Flicker, FrameSequence, Measured, Trained, View
from ndf_mi.experiments.store import Store
from ndf_mi.experiments.trade.results import Drawn, Timing

V1 = Path(__file__).parents[1] / "data" / "v1"
RECORDS = {
    "m/train": Trained({"seconds": 1.5, "name": "inf"}),
    "m/image/novel_view/inf/000003": Measured(
        View("novel_view", "inf", 3), 0.5, {"psnr": math.inf, "ssim": None}, noise=40.0
    ),
    "m/flicker/train": Flicker(FrameSequence("train", "c", (1, 2, 4)), [math.inf, None], [20.0, 21.0]),
}


def unit(key: str, kind: Any, **inputs: Any) -> Unit[Any]:
    return Unit(key, inputs, lambda: pytest.fail("done again"), kind)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    store = Store(tmp_path / "study.json", "comparison")
    store.about = {"command": "ndf-mi compare …"}
    store.summary = lambda: {"methods": [{"key": "m", "mean": math.inf}]}
    for key, record in RECORDS.items():
        store.put(unit(key, type(record), capture="x"), record)
    return store.file


def test_records_come_back_as_they_were(file: Path) -> None:
    store = Store(file, "comparison")
    assert {
        key: store.fresh(unit(key, type(record), capture="x")) for key, record in RECORDS.items()
    } == RECORDS
    assert store.inputs("m/train") == {"capture": "x"} and store.inputs("absent") == {}


def test_the_file_is_strict_json_with_a_summary_for_readers(file: Path) -> None:
    document = json.loads(file.read_text(), parse_constant=lambda name: pytest.fail(name))
    assert document["about"]["command"] == "ndf-mi compare …" and document["methods"][0]["mean"] == "inf"
    assert document["records"]["m/image/novel_view/inf/000003"]["value"]["figures"] == {
        "psnr": "inf", "ssim": None,
    }


def spoiled(file: Path, *path: Any, value: Any = None) -> Path:
    """The file with the value at a path replaced, or removed for None."""
    document = json.loads(file.read_text())
    at = document
    for key in path[:-1]:
        at = at[key]
    if value is None:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    file.write_text(json.dumps(document))
    return file


IMAGE = ("records", "m/image/novel_view/inf/000003", "value")


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("format",), None, ["format", "found nothing"]),
        (("version",), 3, ["version 3", "version 2"]),
        (("study",), "tradeoff", ["'tradeoff'", "'comparison'"]),
        (("records",), [], ["records", "found []", "object"]),
        (
            (*IMAGE, "seconds"), "fast",
            ["m/image/novel_view/inf/000003", "value.seconds", 'found "fast"', "a finite number"],
        ),
        ((*IMAGE, "figures", "psnr"), True, ["value.figures", "found bool", "number"]),
        ((*IMAGE, "view", "frame"), None, ["value.view.frame", "found nothing"]),
        ((*IMAGE, "kind"), "flicker", ["value.kind", "flicker"]),
        ((*IMAGE[:2], "inputs"), "x", ["inputs", 'found "x"', "object"]),
    ],
)
def test_a_damaged_file_is_refused_by_place(
    file: Path, path: tuple[Any, ...], value: Any, words: list[str]
) -> None:
    with pytest.raises(InputError) as refused:
        store = Store(spoiled(file, *path, value=value), "comparison")
        store.fresh(unit("m/image/novel_view/inf/000003", Measured, capture="x"))
    text = str(refused.value)
    assert str(file) in text and all(word in text for word in words) and "Remove" in text, text


@pytest.mark.parametrize("text", ["", "{", "null", "[" * 100_000, "\ud800"])
def test_a_file_that_is_no_json_object_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "study.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(InputError, match="study.json"):
        Store(tmp_path / "study.json", "comparison")


@pytest.mark.parametrize(
    ("file", "study"),
    [
        ("compare/compare.json", "comparison"), ("ablation/ablation.json", "ablation"),
        ("relight/seen.json", "relighting, seen light"),
    ],
)
def test_comparisons_of_version_1_keep_images_sequences_and_trainings(file: str, study: str) -> None:
    old, store = json.loads((V1 / file).read_text()), Store(V1 / file, study)
    for method in old["methods"]:
        inputs = {"images": method["fingerprint"], "capture": old["capture"]["digest"]}
        for image in method["images"]:
            key = f"{method['key']}/image/{image['split']}/{image['camera']}/{image['frame']:06d}"
            record = store.fresh(unit(key, Measured, **inputs))
            assert record.seconds == image["seconds"] and record.view.frame == image["frame"]
            assert record.figures["box_psnr"] == image["box_psnr"] and set(record.figures) == set(
                method["means"][image["split"]]
            ) - {"box_tpsnr"}
            assert record.noise == method["facts"].get("noise_psnr")
        for flicker in method.get("flicker", []):
            sequence = {key: flicker[key] for key in ("split", "camera", "frames")}
            record = store.fresh(
                unit(f"{method['key']}/flicker/{flicker['split']}", Flicker, **inputs, **sequence)
            )
            assert record.frozen == flicker["frozen"]
        if "budget" in method["facts"]:
            facts = method["facts"]
            assert store.inputs(f"{method['key']}/train") == {
                "capture": facts["capture"],
                "method": method["key"].removesuffix("-converged").removesuffix("-equal-time"),
                "options": {"texture": facts["size"]}, "seed": facts["seed"], "budget": facts["budget"],
            }


def test_a_tradeoff_of_version_1_keeps_points_and_timings() -> None:
    file = V1 / "tradeoff" / "tradeoff.json"
    old, store = json.loads(file.read_text()), Store(file, "tradeoff")
    assert old["points"]
    timings = store.matching("timing/", Timing)
    for row in old["points"]:
        inputs = {"images": row["fingerprint"], "environment": row["under"]}
        drawn = store.fresh(unit(f"draw/{row['key']}", Drawn, **inputs))
        assert (
            drawn.memory == row["memory"]
            and drawn.figures[0].truth["box_psnr"] == row["figures"][0]["truth"]["box_psnr"]
        )
        assert [
            timing.seconds[row["key"]] for key, timing in timings.items() if row["session"] in key
        ] == row["seconds"]


@pytest.mark.parametrize("change", [lambda d: d["methods"][0].pop("images"), lambda d: d.update(methods=3)])
def test_a_damaged_file_of_version_1_is_refused(tmp_path: Path, change: Any) -> None:
    document = json.loads((V1 / "compare" / "compare.json").read_text())
    change(document)
    (tmp_path / "compare.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="version 1"):
        Store(tmp_path / "compare.json", "comparison")
