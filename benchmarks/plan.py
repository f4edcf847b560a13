"""What a planned model costs and gains compared with the full one, on captures that need a part and captures
that do not.

    python benchmarks/plan.py captures/plan --steps 3000 --seeds 3
    python benchmarks/plan.py captures/plan --only poses --put-back colour band detail

Makes the captures below if they are missing (about a minute each), fits a reference surface to each, plans
it, and trains several models around that surface in turns, one step each, so that other work on the machine
affects all alike: the full model, the planned one, the planned one without each part that the capture was
made to need, and, for each finding named by
`--put-back`, the planned one with everything that this finding removed. `--seeds` repeats all of it with
other initial weights and rays.

For each capture it prints what the plan left out, the held-out box PSNR of each model and its difference to
the full one's, the median seconds of a training step and of an image, and their ratios to the full model's.
At the end it prints which claims hold: a planned model is at most 0.1 dB worse than the full one; on captures
that need no part it takes at most 60 % of the time; needed parts are kept, and leaving one out costs more
than 0.1 dB.

A difference has two standard errors: over the held-out images, of its mean over the trainings, which says how
well it generalises to other images; and over the trainings, of its mean over the images, which says how well
it generalises to other seeds and needs at least two.

Finished rows are written to FOLDER/results.json and reused by a command that compares the same models,
trained and rendered alike, on the same capture, machine and sources.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
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

from ndf_mi import machine  # noqa: E402
from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.capture.synthesise.plan import SIZES, Look  # noqa: E402
from ndf_mi.capture.synthesise.synthesise import synthesise  # noqa: E402
from ndf_mi.errors import InputError  # noqa: E402
from ndf_mi.experiments import metrics  # noqa: E402
from ndf_mi.field import Preset  # noqa: E402
from ndf_mi.json_input import load_json  # noqa: E402
from ndf_mi.learn.loop import start  # noqa: E402
from ndf_mi.learn.options import TrainingOptions  # noqa: E402
from ndf_mi.learn.prepare import Reference, planned, reference, with_bands  # noqa: E402
from ndf_mi.learn.trainer import Trainer  # noqa: E402
from ndf_mi.methods.ndf import NeuralField  # noqa: E402
from ndf_mi.planning.plan import Plan  # noqa: E402
from ndf_mi.planning.planner import full_model, put_back  # noqa: E402
from ndf_mi.source_digest import code_digest, sources_digest  # noqa: E402

WORTH, SHARE = 0.1, 0.6
"""dB that a planned model may be worse by and a part has to be worth, and the share of the full model's time
that it may take."""

BAND = {"band": 0.037, "band_inside": 0.028}
"""The band planned for tight clothes, which replaces a wider one where that is left out."""

PARTS: dict[str, dict[str, Any]] = {
    "pose": {"pose_layers": (), "pose_products": False, "grid_features": 2, "deformation_layers": ()},
    "light": {"normal_octaves": -1},
    "view": {"direction_octaves": -1, "direction": "view"},
    "band": BAND,
}
"""Changes to a preset that leave a part out."""

FINDINGS = ("pose", "light", "view", "band", "detail", "colour")
"""Findings that --put-back accepts."""


@dataclass(frozen=True)
class Made:
    """A capture made for this study: clothes and motion, the light, and the parts of the model that it
    needs."""

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
    "sheen": Made(dataclasses.replace(TIGHT, surface="glossy")),
    "loose": Made(dataclasses.replace(TIGHT, clothes="loose")),
    "folds": Made(Look(surface="matte"), ("pose", "light")),
    "bag": Made(Look("still", hair="big", bag=True, surface="matte")),
    "skirt": Made(Look(clothes="skirt", hair="big", surface="matte"), ("pose", "light", "band")),
    "coat": Made(Look(clothes="coat", hair="hat", surface="matte"), ("pose", "light", "band")),
}
"""By name. `plain`, `carried`, whose light turns with the performer, and `poses`, which moves without
changing, need nothing; `sheen` needs nothing that can be measured; `loose` and `bag` stand off, but the
reference surface follows them; the cloth of `skirt` and `coat` leaves it as the legs move."""


@dataclass(frozen=True)
class Options:
    """What is trained and measured."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the captures; missing ones are made."""

    steps: int = 3000
    """Steps of each training."""

    only: tuple[str, ...] = tuple(CAPTURES)
    """Captures."""

    samples: int = 128
    """Candidate samples a ray when rendered."""

    repeats: int = 3
    """Timed renderings of each image, after one that is not timed."""

    seed: int = 0
    """Seed of the first training of each model."""

    seeds: int = 1
    """Trainings of each model, with this seed and the following ones."""

    put_back: tuple[str, ...] = ()
    """Findings whose removed parts are restored in another training of the planned model. Findings that
    removed nothing are skipped."""

    def __post_init__(self) -> None:
        for name, low in (("steps", 1), ("samples", 1), ("repeats", 1), ("seed", 0), ("seeds", 1)):
            if getattr(self, name) < low:
                raise InputError(f"--{name}", str(getattr(self, name)), f"a whole number of at least {low}")
        for name, given, known in (("only", self.only, CAPTURES), ("put-back", self.put_back, FINDINGS)):
            for value in given:
                if value not in known:
                    raise InputError(f"--{name}", repr(value), "one of " + ", ".join(known))


@dataclass
class Row:
    """One model on one capture, trained once: PSNR of each held-out image, and median seconds a step and an
    image."""

    model: str
    step: float = 0.0
    image: float = 0.0
    images: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Summary:
    """One model on one capture, over all of its trainings.

    Attributes:
        model: its name.
        psnr: (seeds, images) dB.
        step, image: seconds, the mean over the trainings.
    """

    model: str
    psnr: np.ndarray
    step: float
    image: float

    def to(self, other: Summary) -> tuple[float, float, float]:
        """The mean difference to another in dB, and its standard errors over images and seeds; NaN for only
        one."""
        difference = self.psnr - other.psnr
        over_images, over_seeds = (standard_error(difference.mean(axis=axis)) for axis in (0, 1))
        return float(difference.mean()), over_images, over_seeds


def standard_error(values: np.ndarray) -> float:
    """Standard error of the mean; NaN for a single value."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def main(options: Options) -> None:
    """Makes, plans, trains, measures and prints."""
    kept = options.folder / "results.json"
    known: dict[str, Any] = load_json(kept) if kept.is_file() else {}
    print(", ".join(machine.describe().values()) + f"; {options.steps} steps, {options.seeds} seeds\n")
    verdicts: list[str] = []
    for name in options.only:
        made = CAPTURES[name]
        capture = Capture.read(synthesise(options.folder / name, SIZES["plan"], light=made.light,
                                          look=made.look))
        surface = reference(capture, TrainingOptions())
        found = planned(capture, surface).plan
        compared = models(made, found, options.put_back)
        trained = []
        for seed in range(options.seed, options.seed + options.seeds):
            # Everything that the rows depend on.
            of = {"capture": name, "digest": capture.digest, "steps": options.steps,
                  "samples": options.samples, "repeats": options.repeats,
                  "seed": seed, "models": {model: preset.to_dict() for model, preset in compared.items()},
                  "machine": machine.describe(),
                  "sources": sources()}
            key = hashlib.sha256(json.dumps(of, sort_keys=True).encode()).hexdigest()[:20]
            if key not in known:
                rows = study(name, capture, surface, found, compared, options, seed)
                known[key] = {"of": of, "rows": [dataclasses.asdict(row) for row in rows]}
                files.write_json(kept, known)
            trained.append([Row(**row) for row in known[key]["rows"]])
        verdicts += shown(name, made, found, [summary(rows) for rows in zip(*trained, strict=True)], options)
    print("\n".join(verdicts))


def sources() -> str:
    """SHA-256 (hex) of the sources that train and render."""
    digests = code_digest() + sources_digest("learn", "surface", "planning")
    return hashlib.sha256(digests.encode()).hexdigest()


def models(made: Made, found: Plan, back: tuple[str, ...]) -> dict[str, Preset]:
    """The models compared on a capture."""
    without = {f"planned, without {part}": dataclasses.replace(found.preset, **PARTS[part])
               for part in made.needs}
    took = {finding.key for finding in found.findings if finding.left_out and finding.changes}
    return {"full": full_model(), "planned": found.preset, **without,
            **{f"planned, with {key}": put_back(found, key) for key in back if key in took}}


def summary(rows: tuple[Row, ...]) -> Summary:
    """One model's rows of all trainings."""
    return Summary(rows[0].model, np.array([row.images for row in rows]),
                   float(np.mean([row.step for row in rows])),
                   float(np.mean([row.image for row in rows])))


def study(name: str, capture: Capture, surface: Reference, found: Plan, presets: dict[str, Preset],
          options: Options, seed: int) -> list[Row]:
    """Trains models in turns around the same surface, then renders them in turns."""
    rows = [Row(name) for name in presets]
    training = TrainingOptions(steps=options.steps, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        trainers = [start(Path(folder) / str(i), capture, preset, training,
                          surface=with_bands(surface, found.bands, found.preset, preset, training))
                    for i, preset in enumerate(presets.values())]
        steps = track(range(options.steps), f"{name}, seed {seed}: training {len(rows)} models",
                      console=Console(file=sys.stderr))
        seconds = np.array([[_timed(trainer) for trainer in trainers] for _ in steps])
        for trainer in trainers:
            trainer.publish()
        methods = [NeuralField.of(trainer.run, options.samples) for trainer in trainers]
        taken: list[list[list[float]]] = [[] for _ in rows]
        for camera, frame in capture.splits["novel_view"]:
            truth = capture.image(camera, frame)
            box = metrics.box_mask(capture.cameras[camera],
                                   capture.poses.vertices[capture.poses.index(frame)])
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
        row.step, row.image = float(later[i]), float(np.median(taken[i]))
    return rows


def _timed(trainer: Trainer) -> float:
    begun = time.perf_counter()
    trainer.step()
    dr.sync_thread()
    return time.perf_counter() - begun


def shown(name: str, made: Made, found: Plan, rows: list[Summary], options: Options) -> list[str]:
    """Prints a capture's table; returns which claims hold on it."""
    full, chosen = rows[0], rows[1]
    print(f"{name}: needs {', '.join(made.needs) or 'nothing'}; the plan leaves out "
          + ", ".join(f"{finding.key} ({finding.left_out})"
                      for finding in found.findings if finding.left_out))
    passed = [key for key in options.put_back if f"planned, with {key}" not in {row.model for row in rows}]
    if passed:
        print(f"nothing to restore of {', '.join(passed)}")
    seeds, images = full.psnr.shape
    print(f"\n± images: the standard error over {images} images; ± seeds: that over {seeds} "
          f"{'trainings' if seeds > 1 else 'training'}"
          "\n\n| | PSNR | to full | ± images | ± seeds | s a step | ratio | s an image | ratio |\n"
          "| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        mean, over_images, over_seeds = row.to(full)
        print(f"| {row.model} | {row.psnr.mean():.2f} | {mean:+.2f} | {_error(over_images)} | "
              f"{_error(over_seeds)} | {row.step:.4f} "
              f"| {row.step / full.step:.2f} | {row.image:.4f} | {row.image / full.image:.2f} |")
    print(flush=True)
    p = found.preset
    has = {"pose": bool(p.pose_layers), "light": p.normal_octaves >= 0, "view": p.direction_octaves >= 0,
           "band": p.band > 1.5 * BAND["band"]}
    verdicts = [_verdict(name, f"{part} is {'kept' if has[part] else 'left out'}",
                         has[part] == (part in made.needs)) for part in PARTS]
    verdicts.append(_verdict(name, f"planned {_difference(chosen, full)} to the full model",
                             chosen.to(full)[0] >= -WORTH))
    for what, ratio in (("training", chosen.step / full.step),
                        ("rendering", chosen.image / full.image)) if not made.needs else ():
        verdicts.append(_verdict(name, f"{what} in {100 * ratio:.0f} % of the full model's time",
                                 ratio <= SHARE))
    for row in rows[2 : 2 + len(made.needs)]:
        verdicts.append(_verdict(name, f"{row.model} {_difference(row, chosen)} to the planned one",
                                 row.to(chosen)[0] < -WORTH))
    return verdicts


def _difference(row: Summary, other: Summary) -> str:
    mean, over_images, over_seeds = row.to(other)
    return f"{mean:+.2f} dB (± {_error(over_images)} over images, {_error(over_seeds)} over seeds)"


def _error(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


def _verdict(name: str, text: str, good: bool) -> str:
    return f"{'holds' if good else 'FAILS'}  {name}: {text}"


if __name__ == "__main__":
    try:
        main(tyro.cli(Options, description=__doc__))
    except InputError as error:
        sys.exit(str(error))
