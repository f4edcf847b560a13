"""``ndf-mi stability``: numbers at their extremes, held against float64."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ndf_mi.errors import InputError


@dataclass
class Stability:
    """Compare what is computed, and its gradients, with float64 at the extremes of every input; print a table of the errors and of what is
    promised of them.

    Exit code 0 where every promise is kept and everything is finite, else 1. A case that raises is broken; the others go on.
    """

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """File for the table, as markdown (.md), or for everything measured, as JSON (.json)."""

    only: tuple[str, ...] = ()
    """Cases or subjects to try, by name; all by default."""

    quick: bool = False
    """Leave out what takes more than a few seconds."""

    list: bool = False
    """Name the cases, and try none."""

    def run(self) -> int:
        """Tries the cases one by one, prints a row as each is done, and writes the file."""
        import drjit as dr
        import mitsuba as mi
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        import ndf_mi
        from ndf_mi.stability import report, suite

        if self.out is not None:
            report.check(self.out)
        named = suite.cases(self.only)
        chosen = [case for case in named if not (self.quick and case.long)]
        if not chosen:
            raise InputError("--quick", f"it with --only {' '.join(self.only)}, of which all take long", "one of the two")
        console = Console(highlight=False, width=None if sys.stdout.isatty() else 200)
        if self.list:
            for case in chosen:
                console.print(f"{case.subject:<12} {case.name:<28} {case.what}", soft_wrap=True, markup=False)
            return 0
        results = []
        bar = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=Console(file=sys.stderr), transient=True,
                       disable=not sys.stderr.isatty())
        console.print(report.line(report.HEADER), soft_wrap=True, markup=False)
        with bar:
            task = bar.add_task("", total=len(chosen))
            for case in chosen:
                bar.update(task, description=case.name)
                result = case.attempt()
                results.append(result)
                console.print(report.line(report.cells(result)), style="" if result.passed else "bold red", soft_wrap=True, markup=False)
                for line in report.details(result):
                    console.print(f"  {line}", soft_wrap=True, markup=False)
                sys.stdout.flush()
                bar.advance(task)
        failed = [result.case.name for result in results if not result.passed]
        print(f"\n{len(results)} cases, {len(failed)} broken{': ' + ', '.join(failed) if failed else ''}")
        if self.out is not None:
            about = {"ndf_mi": ndf_mi.__version__, "mitsuba": mi.__version__, "drjit": dr.__version__, "variant": mi.variant()}
            report.write(self.out, results, about)
            print(self.out)
        return 1 if failed or not results else 0
