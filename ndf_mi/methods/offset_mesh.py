"""The textured mesh with offsets: the posed body, moved by static vertex offsets, with one texture for all frames."""

from __future__ import annotations

from dataclasses import dataclass, field

import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.methods.mesh import MeshFacts, TexturedMesh
from ndf_mi.surface.offset_fit import OffsetFit, best_offset_rate
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.texture_fit import Progress, best_rate


@dataclass
class OffsetFacts(MeshFacts):
    """`MeshFacts`, and of the offsets:

    Attributes:
        offset_rate: the first step, metres.
        offset_sweep: training loss reached by each first step tried, keyed by the step as text.
        offset_median_mm, offset_max_mm: of the offsets' lengths over the vertices.
    """

    offset_rate: float = 0.0
    offset_sweep: dict[str, float] = field(default_factory=dict)
    offset_median_mm: float = 0.0
    offset_max_mm: float = 0.0


class OffsetMesh(TexturedMesh):
    """Baseline: the textured mesh, whose vertices are optimised along with the texture; what a Mitsuba user would do next.

    The offsets belong to the body at rest and move with its skin (`rest.RestFrames`), one for all frames: the clothed
    shape is learnt, its wrinkles' changes with the pose are not. Topology and texture coordinates stay.

    Args:
        capture: whose body, poses and background it renders.
        size: texels a side of the square texture.
        rate: Adam's learning rate for the texture; None finds the best of a sweep when `fit` is called.
        offset_rate: first step of the offsets, metres; None finds the best of a sweep likewise.
    """

    facts_type = OffsetFacts

    def __init__(
        self, capture: Capture, size: int = 512, rate: float | None = None, offset_rate: float | None = None
    ) -> None:
        super().__init__(capture, size, rate)
        self.name = "offset mesh"
        self._facts: OffsetFacts = OffsetFacts(size=size, rate=rate or 0.0, offset_rate=offset_rate or 0.0)
        self._rest = RestFrames(capture)
        self.offsets = np.zeros_like(self._rest.vertices, dtype=np.float32)

    def fit(
        self, capture: Capture, seconds: float | None = None, seed: int = 0, progress: Progress | None = None
    ) -> None:
        """Optimises texture and offsets together; arguments as `TexturedMesh.fit`."""
        facts = self._facts
        if not facts.rate:
            facts.rate, facts.sweep, facts.sweep_seconds = best_rate(self._surface, capture, facts.size, seed)
        if not facts.offset_rate:
            found = best_offset_rate(self._surface, self._rest, capture, facts.size, facts.rate, seed)
            facts.offset_rate, facts.offset_sweep, taken = found
            facts.sweep_seconds += taken
        fit = OffsetFit(self._surface, self._rest, capture, facts.size, facts.rate, facts.offset_rate, seed)
        self._train(fit, capture, seconds, seed, progress)
        self.offsets = fit.offsets()
        lengths = 1000 * np.linalg.norm(self.offsets, axis=1)
        facts.offset_median_mm, facts.offset_max_mm = float(np.median(lengths)), float(lengths.max())

    def tensors(self) -> dict[str, np.ndarray]:
        """`texture`, `seen`, and `offsets` (V, 3) in metres at rest."""
        return {**super().tensors(), "offsets": self.offsets}

    def _restore(self, tensors: dict[str, np.ndarray]) -> None:
        super()._restore(tensors)
        self.offsets = tensors["offsets"]

    def _pose(self, frame: int) -> None:
        self._surface.set_vertices(mi.Float(self._rest.posed(frame, self.offsets).ravel()))
