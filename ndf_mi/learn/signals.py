"""Signals that end a training after its present step."""

from __future__ import annotations

import signal
import threading
from typing import Any


class Signals:
    """Records SIGINT and SIGTERM instead of their usual effect, which a second signal has.

    Attributes:
        received: whether one has arrived.
    """

    def __init__(self) -> None:
        self.received = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._record)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _record(self, number: int, _frame: object) -> None:
        self.received = True
        signal.signal(number, self._before[number])
