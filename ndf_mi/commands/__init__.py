"""The command line ``ndf-mi``: finds the command, parses its options, runs it.

Each command is one module here with one dataclass. Its fields are the options, their docstrings the help; its
method ``run() -> int | None`` returns the exit code, None for 0. The class attribute ``deprecated`` lists
renamed options (:mod:`ndf_mi.deprecated`). A module is imported only when its command is called.
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
"""What shells report for a process that SIGPIPE ended."""


@dataclass(frozen=True)
class Entry:
    """A command.

    Attributes:
        name: the words that call it, such as ``capture check``.
        module: the module here that holds it.
        cls: its dataclass.
        summary: what it does, in one line.
        variant: whether a variant of Mitsuba is set before the module is imported.
    """

    name: str
    module: str
    cls: str
    summary: str
    variant: bool = True


ENTRIES = (
    Entry("doctor", "doctor", "Doctor", "report what works here, and how to repair the rest", variant=False),
    Entry("capture synthesise", "capture_synthesise", "CaptureSynthesise", "render a synthetic capture"),
    Entry("capture check", "capture_check", "CaptureCheck", "report what is wrong with a capture"),
    Entry("capture import", "capture_import", "CaptureImport", "convert ZJU-MoCap or DynaCap into a capture"),
    Entry("plan", "plan", "PlanCapture", "find which parts of the model a capture needs, and why"),
    Entry("optimise", "optimise", "Optimise", "train a neural deformable field on a capture"),
    Entry("compare", "compare", "Compare", "compare a trained field with other methods; write report.html"),
    Entry("relight", "relight", "Relight", "render a scattering field in another light; write report.html"),
    Entry("ablate", "ablate", "Ablate", "train every ablation on a capture; write a table and report.html"),
    Entry("tradeoff", "tradeoff", "Tradeoff", "measure what speed costs in accuracy; write report.html"),
    Entry("render", "render", "Render", "render a scene or a trained run to an image"),
    Entry("animate", "animate", "Animate", "render a trained run in another motion, as a video"),
    Entry("stability", "stability", "Stability", "compare numbers at their extremes with float64"),
    Entry("demo", "demo", "Demo", "synthesise a small capture, train, compare; about ten minutes"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs ``ndf-mi``.

    Args:
        argv: the arguments; None for the process's own.

    Returns:
        the exit code: the command's own, 2 for invalid input, 130 after an interrupt.
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
    except SystemExit as exit_:  # tyro's: 0 after --help, 2 after a usage error
        return exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)


def console() -> int:
    """The installed command: :func:`main`, without an error in ``ndf-mi --help | head``."""
    try:
        code = main()
        sys.stdout.flush()
    except BrokenPipeError:
        # The interpreter flushes again when it exits.
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
    head = "usage: ndf-mi COMMAND [OPTIONS]; `ndf-mi COMMAND --help` lists the options\n"
    return "\n".join([head, *(f"  {entry.name:<{width}}  {entry.summary}" for entry in entries)])


def _parse(entry: Entry, arguments: Sequence[str]) -> Any:
    if entry.variant:
        from ndf_mi import variants

        variants.use()
    import tyro

    cls = getattr(importlib.import_module(f"{__name__}.{entry.module}"), entry.cls)
    arguments = rewrite_arguments(arguments, getattr(cls, "deprecated", ()))
    return tyro.cli(
        cls, prog=f"ndf-mi {entry.name}", args=arguments, description=inspect.cleandoc(cls.__doc__ or "")
    )


def _no_such_command(arguments: Sequence[str]) -> int:
    """Prints the list of commands, or of a group's (``capture``) where `arguments` begin with one."""
    word = arguments[0] if arguments else ""
    group = [entry for entry in ENTRIES if entry.name.split()[0] == word]
    asked_for_help = bool(group) and arguments[1:] in (["-h"], ["--help"])
    if not asked_for_help:
        found = f"`{' '.join(arguments[:2] if group else arguments[:1])}`" if arguments else "no command"
        print(f"ndf-mi: error: found {found}; expected one of these commands:", file=sys.stderr)
    print(usage(group or ENTRIES), file=sys.stdout if asked_for_help else sys.stderr)
    return 0 if asked_for_help else USAGE_ERROR
