"""The file of a study: its records with the inputs that they depend on, validated on reading, replaced as a
whole.

    {"format": "ndf-study", "version": 2, "study": "comparison", "about": {…},
     "records": {KEY: {"inputs": {NAME: VALUE}, "value": {"kind": …, …}}}, …}

`about` describes the study for its report. A study may add a summary, such as means, under names of its own;
it is for readers of the file and is not read again. An infinite figure is written as "inf". Files of version
1 are converted on reading (`ndf_mi.experiments.version1`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import Struct

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.experiments import version1
from ndf_mi.experiments.core import Unit
from ndf_mi.json_input import load_json, validated

FORMAT = "ndf-study"
VERSION = 2

NO_RECORD = "no record"
REPAIR = "Remove the file to measure everything again."

R = TypeVar("R", bound=Struct)


class Entry(Struct):
    """A record on disk: the inputs of its unit, and its value."""

    inputs: dict[str, Any]
    value: dict[str, Any]


class Document(Struct):
    """A whole file; see the module."""

    format: str
    version: int
    study: str
    about: dict[str, Any]
    records: dict[str, Any]


class Store:
    """The records of one study.

    Args:
        file: the study's file; it need not exist.
        study: the name of the kind of study, such as `comparison`.

    Attributes:
        about: describes the study; written with the next record.
        summary: returns what is added to the file for readers; called at each write.

    Raises:
        InputError: the file cannot be read, or is of another kind or version.
    """

    def __init__(self, file: Path, study: str) -> None:
        self.file = file
        self.study = study
        self.about: dict[str, Any] = {}
        self.summary: Callable[[], dict[str, Any]] = dict
        self._entries = read_entries(file, study) if file.exists() else {}

    def fresh(self, unit: Unit[R]) -> R | None:
        """The record of a unit, or None if it is missing or stale.

        Raises:
            InputError: the stored record is not of the unit's type.
        """
        return None if self.staleness(unit) else self._value(unit.key, unit.record)

    def staleness(self, unit: Unit[Any]) -> str:
        """Why a unit has to be done: `no record`, or the inputs that changed and the outputs that are
        missing; empty if its record is fresh.
        """
        entry = self._entries.get(unit.key)
        if entry is None:
            return NO_RECORD
        wanted = _plain(unit.inputs)
        names = sorted(wanted.keys() | entry.inputs.keys())
        changed = [name for name in names if wanted.get(name) != entry.inputs.get(name)]
        reasons = [f"{', '.join(changed)} changed"] if changed else []
        reasons += [f"{path} missing" for path in unit.outputs if not path.exists()]
        return "; ".join(reasons)

    def inputs(self, key: str) -> dict[str, Any]:
        """The inputs that a stored record depends on; empty if there is no such record."""
        return self._entries[key].inputs if key in self._entries else {}

    def put(self, unit: Unit[R], record: R) -> None:
        """Stores a record and writes the file."""
        self._entries.pop(unit.key, None)
        self._entries[unit.key] = Entry(_plain(unit.inputs), _written(msgspec.to_builtins(record)))
        self.write()

    def matching(self, prefix: str, record: type[R]) -> dict[str, R]:
        """All stored records whose keys begin with `prefix`, fresh or not, from the oldest to the newest.

        Raises:
            InputError: one of them is not of this type.
        """
        return {key: self._value(key, record) for key in self._entries if key.startswith(prefix)}

    def write(self) -> None:
        """Writes the file, whole or not at all."""
        head = {"format": FORMAT, "version": VERSION, "study": self.study, "about": self.about}
        head = _written(msgspec.to_builtins({**head, **self.summary()}))
        files.write_json(self.file, {**head, "records": msgspec.to_builtins(self._entries)})

    def _value(self, key: str, record: type[R]) -> R:
        where = f"{self.file}: records[{key!r}].value"
        return validated(_restored(self._entries[key].value), record, where, REPAIR)


def read_entries(file: Path, study: str) -> dict[str, Entry]:
    """The records of a study's file, by key.

    Raises:
        InputError: it is not a file of such a study, or is damaged.
    """
    found = load_json(file, f"a {FORMAT} file", REPAIR)
    if isinstance(found, dict) and version1.is_old(found):
        found = version1.converted(found, study, file)
    document = validated(found, Document, str(file), REPAIR)
    if (document.format, document.version, document.study) != (FORMAT, VERSION, study):
        found = f"format {document.format!r}, version {document.version}, study {document.study!r}"
        expected = f"format {FORMAT!r}, version {VERSION}, study {study!r}"
        raise InputError(file, found, expected, REPAIR)
    return {
        key: validated(entry, Entry, f"{file}: records[{key!r}]", REPAIR)
        for key, entry in document.records.items()
    }


def _plain(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Inputs as they come back from JSON: lists in place of tuples."""
    return msgspec.json.decode(msgspec.json.encode(dict(inputs)), type=dict[str, Any])


#: Where figures stand in records: only there does the text "inf" mean infinity.
_FIGURES = ("figures", "tpsnr", "frozen", "truth", "converged", "model")


def _written(value: Any) -> Any:
    """JSON values with infinity as text."""
    if isinstance(value, dict):
        return {key: _written(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_written(item) for item in value]
    return "inf" if value == math.inf else value


def _restored(value: Any, figures: bool = False) -> Any:
    """The inverse of `_written`."""
    if isinstance(value, dict):
        return {key: _restored(item, figures or key in _FIGURES) for key, item in value.items()}
    if isinstance(value, list):
        return [_restored(item, figures) for item in value]
    return math.inf if figures and value == "inf" else value
