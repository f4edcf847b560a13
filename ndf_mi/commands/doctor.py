"""``ndf-mi doctor``: what is here, what works, and the command that mends what does not."""

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
    """Says what is installed and works on this machine, and for each missing thing the command that mends it.

    Exit code 0 where a variant renders and the body's data are there, else 1.
    """

    def run(self) -> int:
        """Prints one line a finding; returns the exit code."""
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
