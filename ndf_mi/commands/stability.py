"""``ndf-mi stability``: numbers at their extremes, held against float64."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class Stability:
    """Compare what is computed, and its gradients, with float64 at the extremes of every input; print a table of the errors and of what is
    promised of them.

    Exit code 0 where every promise is kept and everything is finite, else 1.
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
        """Tries the cases one by one, prints their rows as they come, and writes the file."""
        import drjit as dr
        import mitsuba as mi
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.table import Table

        import ndf_mi
        from ndf_mi.stability import report, suite

        if self.out is not None:
            report.check(self.out)
        chosen = [case for case in suite.cases(self.only) if not (self.quick and case.long)]
        console = Console(highlight=False, width=None if sys.stdout.isatty() else 200)
        if self.list:
            for case in chosen:
                console.print(f"{case.subject:<12} {case.name:<28} {case.what}", soft_wrap=True, markup=False)
            return 0
        results = []
        bar = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=Console(file=sys.stderr), transient=True,
                       disable=not sys.stderr.isatty())
        with bar:
            task = bar.add_task("", total=len(chosen))
            for case in chosen:
                bar.update(task, description=case.name)
                results.append(case.run())
                bar.advance(task)
        table = Table(box=None, pad_edge=False)
        for name in report.HEADER:
            table.add_column(name, justify="right" if name in ("primal", "gradient") else "left", no_wrap=name in ("case", "verdict"))
        for result in results:
            table.add_row(*report.cells(result), style="" if result.passed else "bold red")
        console.print(table)
        broken = [line for result in results for line in report.details(result)]
        for line in broken:
            console.print(line, markup=False)
        failed = [result.case.name for result in results if not result.passed]
        print(f"\n{len(results)} cases, {len(failed)} broken{': ' + ', '.join(failed) if failed else ''}")
        if self.out is not None:
            about = {"ndf_mi": ndf_mi.__version__, "mitsuba": mi.__version__, "drjit": dr.__version__, "variant": mi.variant()}
            report.write(self.out, results, about)
            print(self.out)
        return 1 if failed or not results else 0
