"""All cases, by subject."""

from __future__ import annotations

import importlib

from ndf_mi.errors import InputError
from ndf_mi.stability.case import CASES, Case

SUBJECTS = ("integration", "rays", "fields", "geometry", "bodies", "cameras", "learning", "images")
"""Modules of this package that hold cases, in the order that they are run."""


def cases(names: tuple[str, ...] = ()) -> list[Case]:
    """The cases of these names or subjects; all without any.

    Raises:
        InputError: there is no such case.
    """
    for subject in SUBJECTS:
        importlib.import_module(f"{__package__}.{subject}")
    wrong = [name for name in names if name not in CASES and name not in SUBJECTS]
    if wrong:
        raise InputError("--only", ", ".join(wrong), f"subjects ({', '.join(SUBJECTS)}) or cases ({', '.join(CASES)})")
    return [case for case in CASES.values() if not names or case.name in names or case.subject in names]

