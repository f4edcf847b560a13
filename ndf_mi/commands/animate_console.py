"""What ``ndf-mi animate`` shows in the terminal: frames rendered and encoded, and the time that is left."""

from __future__ import annotations

from collections.abc import Callable
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class FrameProgress:
    """One line a phase; use as a context manager. Nothing is shown where the stream is no terminal."""

    def __init__(self, stream: TextIO) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[facts]}"), TimeElapsedColumn(),
                   TextColumn("left"), TimeRemainingColumn())  # fmt: skip
        self._progress = Progress(*columns, console=Console(file=stream), disable=not stream.isatty())

    def __enter__(self) -> FrameProgress:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Leaves the lines as they are, so that text may follow."""
        self._progress.stop()

    def phase(self, name: str, todo: int, of: int) -> Callable[[], None]:
        """A line for ``todo`` of ``of`` frames, the others being there already; what it returns is called after each."""
        done = of - todo
        task = self._progress.add_task(name, total=todo, facts=f"frame {done} of {of}")

        def step() -> None:
            nonlocal done
            done += 1
            self._progress.update(task, advance=1, facts=f"frame {done} of {of}")

        return step
