"""The parameters that had the least error on the held-back rays so far."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ndf_mi.errors import InputError


class Best:
    """Keeps the best of the states of a training's optimisers. Arrays are shared, not copied.

    Attributes:
        step: steps taken when the parameters that are kept were measured; 0 before the first.
        error: their mean squared error in sRGB on the held-back rays.
        last: that of the parameters measured last.
        last_step, last_done: steps taken, and share of the training done, when these were measured.
        parameters: those kept, detached, by optimiser and key; empty before the first, and once released.
        released: whether nothing is kept any more, since the rays are trained on.
    """

    def __init__(self) -> None:
        self.step = self.last_step = 0
        self.error = self.last = float("nan")
        self.last_done = 0.0
        self.parameters: dict[str, dict[str, Any]] = {}
        self.released = False

    def release(self) -> None:
        """Keeps nothing from now on: the rays will be trained on, and say nothing more."""
        self.step, self.error, self.parameters, self.released = 0, float("nan"), {}, True

    def observe(self, step: int, done: float, error: float, optimisers: dict[str, Any]) -> None:
        """Keeps the optimisers' parameters if their error is the least so far.

        Args:
            step: steps taken.
            done: share of the training that is done.
            error: mean squared error of the parameters; one that is not finite is never the least.
            optimisers: by name.
        """
        self.last, self.last_step, self.last_done = error, step, done
        if error < self.error or (not self.parameters and np.isfinite(error)):
            self.step, self.error = step, error
            self.parameters = {name: {key: type(optimiser[key])(dr.detach(optimiser[key]))
                                      for key in optimiser.keys()}  # noqa: SIM118
                               for name, optimiser in optimisers.items()}

    def tensors(self) -> dict[str, np.ndarray]:
        """The parameters as numpy arrays, named ``best.OPTIMISER.KEY``."""
        return {f"best.{name}.{key}": value.numpy()
                for name, values in self.parameters.items() for key, value in values.items()}

    def metadata(self) -> dict[str, Any]:
        """The other attributes as JSON values."""
        return {"step": self.step, "error": _json(self.error), "last": _json(self.last),
                "last_step": self.last_step, "last_done": self.last_done, "released": self.released}

    def restore(self, tensors: dict[str, np.ndarray], metadata: dict[str, Any],
                optimisers: dict[str, Any], where: str) -> None:
        """Returns to what :meth:`tensors` and :meth:`metadata` returned.

        Raises:
            InputError: a tensor is missing or has another size.
            KeyError, TypeError, ValueError: the metadata is not this class's.
        """
        self.step, self.last_step = int(metadata["step"]), int(metadata["last_step"])
        self.last_done = float(metadata["last_done"])
        self.released = bool(metadata.get("released", False))  # Older files lack it.
        self.error, self.last = _number(metadata["error"]), _number(metadata["last"])
        self.parameters = {}
        if self.step == 0:
            return
        for name, optimiser in optimisers.items():
            self.parameters[name] = {}
            for key in optimiser.keys():  # noqa: SIM118
                value, found = optimiser[key], tensors.get(f"best.{name}.{key}")
                if found is None or found.size != dr.width(value):
                    raise InputError(f"{where}: best.{name}.{key}",
                                     "nothing" if found is None else f"{found.size} numbers",
                                     f"{dr.width(value)}")
                self.parameters[name][key] = type(value)(found)


def _json(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
