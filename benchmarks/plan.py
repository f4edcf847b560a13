"""What a planned model costs and gives beside the full one, on captures that need a part and on captures that do not.

    python benchmarks/plan.py captures/plan --steps 3000

Makes the captures below in the folder where they are not there yet (about a minute each), plans each, and trains side by side, a step of
one after a step of the other, so that what else the machine does hits all alike: the full model, the planned one, and for each part that
the capture is made to need the planned one without it. Prints for each capture what the plan left out, the held-out box PSNR of each
model and its difference to the full one's, medians of seconds a training step and an image, and their ratios to the full model's; and
at the end which of the promises are kept: a planned model is at most 0.1 dB worse than the full one, and where parts could be left out
takes at most 60 % of its time; what is needed is kept, and costs more than 0.1 dB where it is left out.

Rows of a capture are written to FOLDER/results.json when it is done, and not measured again by the same command.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from ndf_mi import files, variants

variants.use()

import drjit as dr  # noqa: E402

from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.capture.synthesise.look import Look  # noqa: E402
from ndf_mi.capture.synthesise.plan import SIZES  # noqa: E402
from ndf_mi.capture.synthesise.synthesise import synthesise  # noqa: E402
from ndf_mi.compare import machine, metrics  # noqa: E402
from ndf_mi.compare.methods.ndf import NeuralField  # noqa: E402
from ndf_mi.field import Preset  # noqa: E402
from ndf_mi.json_input import load_json  # noqa: E402
from ndf_mi.learn.loop import start  # noqa: E402
from ndf_mi.learn.options import TrainingOptions  # noqa: E402
from ndf_mi.learn.trainer import Trainer  # noqa: E402
from ndf_mi.planning.plan import Plan  # noqa: E402
from ndf_mi.planning.planner import full_model, plan  # noqa: E402

WORTH, SHARE = 0.1, 0.6
"""dB that a planned model may be worse by and a part has to be worth, and the share of the full model's time that it may take."""

BAND = {"band": 0.022, "band_inside": 0.016}
"""What is planned around tight clothes: what leaving the wider band out means."""

PARTS: dict[str, dict[str, Any]] = {
    "pose": {"pose_layers": (), "deformation_layers": ()},
    "light": {"normal_octaves": -1},
    "view": {"direction_octaves": -1},
    "band": BAND,
}
"""What leaving a part out changes in a preset."""


@dataclass(frozen=True)
class Made:
    """A capture made for the study: what the performer wears and does, the light, and the parts that it needs."""

    look: Look
    needs: tuple[str, ...] = ()
    light: str = "studio"


TIGHT = Look("still", "tight", surface="matte")
CAPTURES = {
    "plain": Made(TIGHT),
    "carried": Made(dataclasses.replace(TIGHT, motion="turn"), light="carried"),
    "poses": Made(dataclasses.replace(TIGHT, motion="clips", folds=False), light="flat"),
    "light": Made(dataclasses.replace(TIGHT, motion="turn"), ("light",)),
    "gloss": Made(dataclasses.replace(TIGHT, motion="turn", surface="glossy"), ("light", "view")),
    "loose": Made(dataclasses.replace(TIGHT, clothes="loose"), ("band",)),
    "folds": Made(Look(surface="matte"), ("pose", "light", "band")),
}
"""By name. `plain` needs nothing; `carried` turns with its light; `poses` moves, but nothing changes; the others each need something."""


@dataclass(frozen=True)
class Options:
    """What is trained and measured."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Where the captures are, or are made."""

    steps: int = 3000
    """Steps of each training."""

    only: tuple[str, ...] = tuple(CAPTURES)
    """Captures."""

    samples: int = 128
    """Candidate samples a ray when rendered."""

    repeats: int = 3
    """Times that every image is rendered for its time, after once."""

    seed: int = 0
    """Of the trainings."""


@dataclass
class Row:
    """One model on one capture: dB, and seconds a step and an image."""

    model: str
    psnr: float = 0.0
    step: float = 0.0
    image: float = 0.0
    images: list[float] = field(default_factory=list)


def main(options: Options) -> None:
    """Makes, plans, trains, measures and prints."""
    kept = options.folder / "results.json"
    known: dict[str, Any] = load_json(kept) if kept.is_file() else {}
    print(", ".join(machine.describe().values()) + f"; {options.steps} steps\n")
    verdicts: list[str] = []
    for name in options.only:
        made = CAPTURES[name]
        capture = Capture.read(synthesise(options.folder / name, SIZES["plan"], light=made.light, look=made.look))
        key = f"{name} {options.steps} {options.samples} {options.repeats} {options.seed}"
        found = plan(capture)
        entry = known.get(key)
        if entry is None or entry["preset"] != found.preset.to_dict():
            rows = study(capture, models(made, found), options)
            entry = known[key] = {"preset": found.preset.to_dict(), "rows": [dataclasses.asdict(row) for row in rows]}
            files.write_json(kept, known)
        verdicts += shown(name, made, found, [Row(**row) for row in entry["rows"]])
    print("\n".join(verdicts))


def models(made: Made, found: Plan) -> dict[str, Preset]:
    """The models compared on a capture."""
    without = {f"without {part}": dataclasses.replace(found.preset, **PARTS[part]) for part in made.needs}
    return {"full": full_model(), "planned": found.preset, **without}


def study(capture: Capture, presets: dict[str, Preset], options: Options) -> list[Row]:
    """Trains models side by side, then renders them side by side."""
    rows = [Row(name) for name in presets]
    training = TrainingOptions(steps=options.steps, seed=options.seed)
    with tempfile.TemporaryDirectory() as folder:
        trainers = [start(Path(folder) / str(i), capture, preset, training) for i, preset in enumerate(presets.values())]
        seconds = np.array([[_timed(trainer) for trainer in trainers] for _ in track(range(options.steps), f"training {len(rows)} models",
                                                                                     console=Console(file=sys.stderr))])
        for trainer in trainers:
            trainer.publish()
        methods = [NeuralField(trainer.run, options.samples) for trainer in trainers]
        taken: list[list[list[float]]] = [[] for _ in rows]
        for camera, frame in capture.splits["novel_view"]:
            truth = capture.image(camera, frame)
            box = metrics.box_mask(capture.cameras[camera], capture.poses.vertices[capture.poses.index(frame)])
            times = np.zeros((options.repeats + 1, len(rows)))
            for repeat in range(options.repeats + 1):
                for i, (row, method) in enumerate(zip(rows, methods, strict=True)):
                    begun = time.perf_counter()
                    image = method.render(capture.cameras[camera], frame)
                    times[repeat, i] = time.perf_counter() - begun
                    if not repeat:
                        row.images.append(metrics.measure(truth, image, box)["box_psnr"])
            for i in range(len(rows)):
                taken[i].append(list(times[1:, i]))
    # The first steps compile.
    later = np.median(seconds[options.steps // 4 :], axis=0)
    for i, row in enumerate(rows):
        row.psnr, row.step, row.image = float(np.mean(row.images)), float(later[i]), float(np.median(taken[i]))
    return rows


def _timed(trainer: Trainer) -> float:
    begun = time.perf_counter()
    trainer.step()
    dr.sync_thread()
    return time.perf_counter() - begun


def shown(name: str, made: Made, found: Plan, rows: list[Row]) -> list[str]:
    """Prints a capture's table; returns what of the promises is kept on it."""
    full, planned = rows[0], rows[1]
    print(f"{name}: needs {', '.join(made.needs) or 'nothing'}; the plan leaves out "
          + ", ".join(f"{finding.key} ({finding.left_out})" for finding in found.findings if finding.left_out) + "\n")
    print("| | PSNR | to full | s a step | ratio | s an image | ratio |\n| --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        difference = np.array(row.images) - np.array(full.images)
        error = difference.std(ddof=1) / np.sqrt(len(difference)) if len(difference) > 1 else float("nan")
        print(f"| {row.model} | {row.psnr:.2f} | {row.psnr - full.psnr:+.2f} ± {error:.2f} | {row.step:.4f} | {row.step / full.step:.2f} "
              f"| {row.image:.4f} | {row.image / full.image:.2f} |")
    print(flush=True)
    p = found.preset
    has = {"pose": bool(p.pose_layers), "light": p.normal_octaves >= 0, "view": p.direction_octaves >= 0,
           "band": p.band > 1.5 * BAND["band"]}
    verdicts = [_verdict(name, f"{part} is {'kept' if has[part] else 'left out'}", has[part] == (part in made.needs)) for part in PARTS]
    verdicts.append(_verdict(name, f"planned {planned.psnr - full.psnr:+.2f} dB", planned.psnr >= full.psnr - WORTH))
    for what, ratio in (("training", planned.step / full.step), ("rendering", planned.image / full.image)):
        verdicts.append(_verdict(name, f"{what} in {100 * ratio:.0f} % of the full model's time", ratio <= SHARE))
    for row in rows[2:]:
        verdicts.append(_verdict(name, f"{row.model}: {row.psnr - planned.psnr:+.2f} dB", row.psnr < planned.psnr - WORTH))
    return verdicts


def _verdict(name: str, text: str, good: bool) -> str:
    return f"{'kept  ' if good else 'MISSED'}  {name}: {text}"


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
