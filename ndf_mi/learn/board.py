"""TensorBoard's event file of a run, written where the extra ``tensorboard`` is installed."""

from __future__ import annotations

import sys
from pathlib import Path

from ndf_mi.errors import InputError
from ndf_mi.optional import install_command, require

EXTRA = "tensorboard"


class Board:
    """Writes scalars to an event file in a run's folder; without tensorboardX it prints how to install it,
    and writes nothing.

    Args:
        folder: the run's folder.
        step: the step that training continues from; events of later steps are discarded.
        quiet: whether to print nothing.
    """

    def __init__(self, folder: Path, step: int, quiet: bool = False) -> None:
        try:
            self._writer = require("tensorboardX", EXTRA).SummaryWriter(str(folder), purge_step=step)
        except InputError:
            self._writer = None
            if not quiet:
                print(f"no TensorBoard events will be written; they need: {install_command(EXTRA)}",
                      file=sys.stderr)

    def scalar(self, name: str, value: float, step: int) -> None:
        """Adds the value of a scalar at a step."""
        if self._writer is not None:
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flushes and closes the file."""
        if self._writer is not None:
            self._writer.close()
