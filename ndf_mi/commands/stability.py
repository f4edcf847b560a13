"""``ndf-mi stability``: computations at the extremes of their inputs, compared with float64."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ndf_mi.errors import InputError

if TYPE_CHECKING:
    from ndf_mi.stability.table import Result, Table

EXTRA = "stability"
#: Modules of cases, in the order in which they run.
SUBJECTS = "integration rays fields majorants geometry bodies cameras learning images".split()


@dataclass
class Stability:
    """Compare computations and their gradients with float64 at the extremes of every input, and print a table
    of the errors and their tolerances.

    The exit code is 0 if all errors are finite and within their tolerances, and 1 otherwise. A case that
    raises an exception counts as exceeding; the others still run. Needs pytest, as
    installed by pip install "ndf-mi[stability]".
    """

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Also write the table to this file, as Markdown (.md), or all measurements, as JSON (.json)."""

    only: tuple[str, ...] = ()
    """Names of cases or subjects to run; all by default."""

    quick: bool = False
    """Leave out cases that take more than a few seconds."""

    list: bool = False
    """List the cases instead of running them."""

    def run(self) -> int:
        """Runs the cases, prints a row as each is done, and writes the file."""
        from ndf_mi.optional import require

        require("pytest", extra=EXTRA)
        import drjit as dr
        import mitsuba as mi

        import ndf_mi
        from ndf_mi.stability import table

        if self.out is not None:
            table.check_suffix(self.out)
        if self.list:
            for result in self._run_tests(collect_only=True).results.values():
                print(f"{result.subject:<12} {result.name:<28} {result.case.what}")
            return 0
        # pytest captures what is printed to the standard output of its time.
        out = sys.stdout

        heading = [table.line(table.HEADER)]

        def report(result: Result) -> None:
            # Unknown names in --only are found before the first case runs: only then is there a table.
            while heading:
                print(heading.pop(), file=out)
            print(table.line(result.cells()), *result.details(), sep="\n  ", file=out, flush=True)

        results = [*self._run_tests(report).results.values()]
        exceeding = [result.name for result in results if not result.within]
        names = f": {', '.join(exceeding)}" if exceeding else ""
        print(f"\n{len(results)} cases, {len(exceeding)} exceed their tolerances{names}")
        if self.out is not None:
            about = {module.__name__: module.__version__ for module in (ndf_mi, mi, dr)}
            about["variant"] = mi.variant()
            table.write(self.out, results, about)
            print(self.out)
        return 1 if exceeding else 0

    def _run_tests(
        self, report: Callable[[Result], None] = lambda result: None, collect_only: bool = False) -> Table:
        """Runs pytest on the suite, without its output and independently of the user's configuration of it.

        Raises:
            InputError: a name in --only is unknown, or no case is left.
        """
        import os

        import pytest

        import ndf_mi.stability
        from ndf_mi.stability.table import Table

        found = Table(self.only, self.quick, report)
        folder = Path(ndf_mi.stability.__file__).parent
        arguments = [
            "-c", os.devnull, f"--rootdir={folder}", f"--confcutdir={folder}", "--import-mode=importlib",
            "--capture=sys", "-p", "no:terminal", "-p", "no:cacheprovider",
            *(["--collect-only"] if collect_only else []),
            *(str(folder / f"test_{subject}.py") for subject in SUBJECTS)]
        with pytest.MonkeyPatch.context() as environment:
            environment.delenv("PYTEST_ADDOPTS", raising=False)
            environment.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
            code = pytest.main(arguments, plugins=[found])
        if found.unknown:
            raise InputError("--only", ", ".join(found.unknown), "names of: " + ", ".join(found.names))
        if not found.names:
            raise RuntimeError(f"pytest cannot collect the cases in {folder} (exit code {code})")
        if not found.results:
            both = f"it with --only {' '.join(self.only)}, whose cases all take long"
            raise InputError("--quick", both, "one of them")
        return found
