"""Progress of ``ndf-mi animate`` in the terminal: frames rendered and encoded, and the time remaining."""

from __future__ import annotations

from collections.abc import Callable
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class FrameProgress:
    """A progress bar for each phase; a context manager. Shows nothing if the stream is no terminal."""

    def __init__(self, stream: TextIO) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[count]}"),
                   TimeElapsedColumn(),
                   TextColumn("left"), TimeRemainingColumn())
        self._progress = Progress(*columns, console=Console(file=stream), disable=not stream.isatty())

    def __enter__(self) -> FrameProgress:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Stops drawing, so that text can follow."""
        self._progress.stop()

    def phase(self, name: str, todo: int, total: int) -> Callable[[], None]:
        """Adds a bar for `todo` of `total` frames, the others being done; returns what to call after each
        frame."""
        done = total - todo
        task = self._progress.add_task(name, total=todo, count=f"frame {done} of {total}")

        def step() -> None:
            nonlocal done
            done += 1
            self._progress.update(task, advance=1, count=f"frame {done} of {total}")

        return step
