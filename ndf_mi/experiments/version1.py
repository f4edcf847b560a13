"""Files that studies wrote in version 1, as documents of today's: what they measured stays of use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError

_FORMATS = ("ndf-comparison", "ndf-tradeoff")
_BUDGETS = ("-converged", "-equal-time")


def is_old(document: dict[str, Any]) -> bool:
    """Whether a study of version 1 wrote this."""
    return document.get("format") in _FORMATS and document.get("version") == 1


def converted(document: dict[str, Any], study: str, file: Path) -> dict[str, Any]:
    """The document of today's version.

    Raises:
        InputError: it lacks what files of that version have.
    """
    try:
        if document["format"] == "ndf-tradeoff":
            study, about, records = "tradeoff", document["about"], _tradeoff(document)
        else:
            others = ("format", "version", "methods")
            about = {key: value for key, value in document.items() if key not in others}
            records = _comparison(document)
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(file, f"a damaged file ({error!r})", "a study of version 1", "Remove it.") from None
    return {"format": "ndf-study", "version": 2, "study": study, "about": about, "records": records}


def _comparison(document: dict[str, Any]) -> dict[str, Any]:
    records: dict[str, Any] = {}
    for method in document["methods"]:
        name, facts = method["key"], method["facts"]
        if "budget" in facts:
            kind = next((name.removesuffix(end) for end in _BUDGETS if name.endswith(end)), name)
            inputs = {
                "capture": facts["capture"], "method": kind, "options": {"texture": facts["size"]},
                "seed": facts["seed"], "budget": facts["budget"],
            }
            records[f"{name}/train"] = {"inputs": inputs, "value": {"kind": "trained", "metadata": facts}}
        drawn = {"images": method["fingerprint"], "capture": document.get("capture", {}).get("digest")}
        for image in method["images"]:
            view = {key: image[key] for key in ("split", "camera", "frame")}
            # Files from before sequences were measured have neither `sampled` nor `flicker`.
            rest = {
                "seconds": image["seconds"], "sampled": image.get("sampled", True),
                "noise": facts.get("noise_psnr"),
            }
            figures = {key: value for key, value in image.items() if key not in {*view, *rest}}
            records[f"{name}/image/{view['split']}/{view['camera']}/{view['frame']:06d}"] = {
                "inputs": drawn, "value": {"kind": "image", "view": view, "figures": figures, **rest},
            }
        for flicker in method.get("flicker", []):
            sequence = {key: flicker[key] for key in ("split", "camera", "frames")}
            value = {"kind": "flicker", "sequence": sequence}
            value |= {key: flicker[key] for key in ("tpsnr", "frozen")}
            inputs = {**drawn, **sequence}
            records[f"{name}/flicker/{flicker['split']}"] = {"inputs": inputs, "value": value}
    return records


def _tradeoff(document: dict[str, Any]) -> dict[str, Any]:
    about, records = document["about"], {}
    sessions = about.get("sessions", {"": about["timing"]} if "timing" in about else {})
    for row in document["points"]:
        value = {
            "kind": "drawn", "figures": row["figures"], "memory": row["memory"], "metadata": row["facts"],
        }
        inputs = {"images": row["fingerprint"], "environment": row.get("under", "")}
        records[f"draw/{row['key']}"] = {"inputs": inputs, "value": value}
    for session, conditions in sessions.items():
        rows = [row for row in document["points"] if row.get("session", "") == session]
        for repeat in range(min((len(row["seconds"]) for row in rows), default=0)):
            value = {
                "kind": "timing", "machine": conditions["machine"], "timed": conditions["timed"],
                "points": {row["key"]: row["fingerprint"] for row in rows},
                "seconds": {row["key"]: row["seconds"][repeat] for row in rows},
            }
            records[f"timing/{session}/{repeat}"] = {"inputs": {"session": session}, "value": value}
    return records
