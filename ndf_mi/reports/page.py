"""A report as one HTML file: templates, the style sheet, and the values that all reports hand to them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from ndf_mi import files
from ndf_mi.reports import pictures


@dataclass(frozen=True)
class Fact:
    """A name with one or more lines of text; `code` prints them as a command."""

    label: str
    lines: tuple[str, ...]
    code: bool = False


def write_page(path: str | os.PathLike[str], template: str, **values: Any) -> None:
    """Renders a template of this package to an HTML file that needs no other file."""
    environment = Environment(
        loader=PackageLoader("ndf_mi.reports"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )
    style = resources.files("ndf_mi.reports").joinpath("style.css").read_text(encoding="utf-8")
    text = environment.get_template(template).render(style=style, gradient=pictures.gradient(), **values)
    files.write_text(path, text)


def origin(about: Mapping[str, Any], *facts: Fact) -> list[Fact]:
    """How a report was made: the command, then `facts`, then the machine."""
    machine = (Fact(label, (str(value),)) for label, value in about["machine"].items())
    return [Fact("Command", (about["command"],), code=True), *facts, *machine]


def capture_fact(about: Mapping[str, Any]) -> Fact:
    """Name and digest of the capture."""
    return Fact("Capture", (f"{about['capture']['name']}, digest {about['capture']['digest'][:16]}…",))


def protocol_fact(about: Mapping[str, Any]) -> Fact:
    """Name and description of the protocol; see `protocol_sentence`."""
    return Fact("Protocol", (protocol_sentence(about),))


def protocol_sentence(about: Mapping[str, Any]) -> str:
    """The protocol by which images were chosen, and what it prescribes."""
    return f"Protocol {about['protocol']['name']}: {about['protocol']['description']}"


def protocol_notes(about: Mapping[str, Any]) -> list[str]:
    """Sentences on where the capture, training or number of images differs from the protocol."""
    return list(about.get("protocol", {}).get("notes", []))


def settings_text(values: Mapping[str, object]) -> str:
    """Options and their values in one line."""
    return ", ".join(f"{key.replace('_', ' ')} {_text(value)}" for key, value in values.items())


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " ".join(map(_text, value))
    return str(value)
