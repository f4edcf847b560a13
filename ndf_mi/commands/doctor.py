"""``ndf-mi doctor``: reports what is installed, what works, and the command that repairs the rest."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape

from ndf_mi import doctor

MARKS = {
    doctor.State.OK: "[green]ok     [/]",
    doctor.State.MISSING: "[red]missing[/]",
    doctor.State.NOTE: "[dim]-      [/]",
}


@dataclass
class Doctor:
    """Report what is installed and works on this machine, and the command that installs each missing part.

    The exit code is 0 if a variant renders and the default body's data are installed, else 1.
    """

    def run(self) -> int:
        """Prints a line for each finding; returns the exit code."""
        console = Console(highlight=False, soft_wrap=True)
        findings = doctor.examine()
        width = max(len(finding.name) for finding in findings)
        for finding in findings:
            console.print(f"{finding.name:<{width}}  {MARKS[finding.state]}  {escape(finding.found)}")
            if finding.repair:
                console.print(f"{'':<{width}}  to repair: [bold]{escape(finding.repair)}[/]")
        healthy = doctor.healthy(findings)
        console.print("\nReady." if healthy else "\nNot ready: see the lines marked `missing`.")
        return 0 if healthy else 1
