"""The command line ``ndf-mi``: finds the command, reads its options, runs it; a user's mistake is exit code 2.

Each command is one module here with one dataclass: a docstring on every field (the options are made of it) and a method
``run() -> int | None``, the exit code. A module is imported only when its command is called. Options that were renamed
stand in the class attribute ``deprecated``, as :mod:`ndf_mi.deprecated` describes.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ndf_mi
from ndf_mi.deprecated import rewrite_arguments
from ndf_mi.errors import InputError

USAGE_ERROR = 2
INTERRUPTED = 130
UNREAD = 141
"""As shells report a process that SIGPIPE ended."""


@dataclass(frozen=True)
class Entry:
    """A command: its words, the module and class behind it, and what it does in one line."""

    name: str
    module: str
    cls: str
    summary: str
    variant: bool = True
    """Whether a variant of Mitsuba is set before the module is imported."""


ENTRIES = (
    Entry("doctor", "doctor", "Doctor", "say what is installed, what works, and how to repair the rest", variant=False),
    Entry("capture synthesise", "capture_synthesise", "CaptureSynthesise", "render a capture of a synthetic performer"),
    Entry("capture check", "capture_check", "CaptureCheck", "say exactly what is wrong with a capture folder"),
    Entry("capture import", "capture_import", "CaptureImport", "make a capture of one of ZJU-MoCap or DynaCap"),
    Entry("plan", "plan", "PlanCapture", "say which model a capture needs, and why"),
    Entry("optimise", "optimise", "Optimise", "train a neural deformable field on a capture"),
    Entry("compare", "compare", "Compare", "compare a trained field with a textured mesh; write report.html"),
    Entry("relight", "relight", "Relight", "show a run in another light, beside a diffuse textured mesh"),
    Entry("ablate", "ablate", "Ablate", "train every ablation on a capture; write their table and report.html"),
    Entry("tradeoff", "tradeoff", "Tradeoff", "measure what speed costs in accuracy on a run; write report.html"),
    Entry("render", "render", "Render", "render a scene or a trained run to an image"),
    Entry("animate", "animate", "Animate", "render a trained run in any motion, as a video"),
    Entry("stability", "stability", "Stability", "hold numbers at their extremes against float64; exit non-zero where a promise is broken"),
    Entry("demo", "demo", "Demo", "all of the above on a small capture, in minutes"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs ``ndf-mi``; ``argv`` defaults to the process's arguments.

    Returns:
        The exit code: 0, the command's own, 2 for a user's mistake, 130 where the user interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        print(f"ndf-mi {ndf_mi.__version__}")
        return 0
    if arguments[:1] in (["-h"], ["--help"]):
        print(usage(ENTRIES))
        return 0
    entry = find(arguments)
    if entry is None:
        return _no_such_command(arguments)
    try:
        return int(_parse(entry, arguments[len(entry.name.split()) :]).run() or 0)
    except InputError as error:
        print(f"ndf-mi: error: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("ndf-mi: interrupted", file=sys.stderr)
        return INTERRUPTED
    except SystemExit as leaving:  # tyro's: 0 after --help, 2 after a usage error
        return leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)


def console() -> int:
    """What the installed command calls: :func:`main`, ending quietly where nobody reads on, as in ``ndf-mi --help | head -1``."""
    try:
        code = main()
        sys.stdout.flush()
    except BrokenPipeError:
        # The interpreter flushes once more when it leaves.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNREAD
    return code


def find(arguments: Sequence[str]) -> Entry | None:
    """The entry whose words begin ``arguments``, or None."""
    for entry in ENTRIES:
        words = entry.name.split()
        if list(arguments[: len(words)]) == words:
            return entry
    return None


def usage(entries: Sequence[Entry]) -> str:
    """The list of commands, as ``--help`` shows it."""
    width = max(len(entry.name) for entry in entries)
    lines = [f"  {entry.name:<{width}}  {entry.summary}" for entry in entries]
    return "\n".join(["usage: ndf-mi COMMAND [OPTIONS]; `ndf-mi COMMAND --help` lists the options", "", *lines])


def _parse(entry: Entry, arguments: Sequence[str]) -> Any:
    if entry.variant:
        from ndf_mi import variants

        variants.use()
    import tyro

    cls = getattr(importlib.import_module(f"{__name__}.{entry.module}"), entry.cls)
    arguments = rewrite_arguments(arguments, getattr(cls, "deprecated", ()))
    return tyro.cli(cls, prog=f"ndf-mi {entry.name}", args=arguments, description=inspect.cleandoc(cls.__doc__ or ""))


def _no_such_command(arguments: Sequence[str]) -> int:
    """Prints the commands that there are, those of a group (``capture``) alone where one was named."""
    word = arguments[0] if arguments else ""
    group = [entry for entry in ENTRIES if entry.name.split()[0] == word]
    asked_for_help = bool(group) and arguments[1:] in (["-h"], ["--help"])
    if not asked_for_help:
        known = f"`{' '.join(arguments[:2] if group else arguments[:1])}`" if arguments else "no command"
        print(f"ndf-mi: error: found {known}; expected one of those below", file=sys.stderr)
    print(usage(group or ENTRIES), file=sys.stdout if asked_for_help else sys.stderr)
    return 0 if asked_for_help else USAGE_ERROR
