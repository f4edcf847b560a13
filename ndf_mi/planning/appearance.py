"""Estimates from training images of what the colours on the body's surface depend on.

Each pixel shows a place on the body. The mean colour of a place needs no other input. The residual is
predicted by small linear models from the turning of the surface's world normal or from the view direction
mirrored at the surface, or compared between frames. An estimate is the reduction of the mean squared error in
sRGB *on data that was not fitted*; an input that explains nothing gives zero or less.

The body is only near the surface that the images show, so cameras that look at one place of the body from
different sides see different places of the cloth. That error differs from region to region and, in the
estimate by frames, is the same for both kinds of pairs that are compared. It makes estimates less certain,
not larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.planning.observations import Observations

#: Edge of a cell, which is one place, in pixel footprints; of a patch, across which shading is constant, in
#: cells; and of a region, across which one material responds to light and view alike, in metres.
CELL, PATCH, REGION = 2.0, 3, 0.3
#: Ridge: the variance of a pixel's colour about its prediction, about 1e-2, over that of a regressor's
#: weight, 0.1². Regressors are not scaled: one that hardly varies in the fitted images must not get a large
#: weight.
_RIDGE = 1.0
#: Number of parts that frames are divided into for cross-validation.
_FOLDS = 6
#: Directions of highlights and their concentration: lobes of about 30 degrees, as far apart as their
#: neighbours.
_LOBES, _CONCENTRATION = 32, 8.0
#: Limit on the rows that estimates use; places are drawn at random.
_MOST_ROWS = 40_000
#: Width of the bins, in cosines, of the angle between two cameras' directions to a place.
_BIN = 0.1


@dataclass(frozen=True)
class Estimate:
    """A mean squared difference in sRGB, averaged over channels, and its standard error."""

    value: float
    error: float

    @property
    def significant(self) -> bool:
        """Whether it is above zero by more than two standard errors."""
        return self.value > 2 * self.error


#: What the images cannot answer.
UNKNOWN = Estimate(0.0, float("inf"))


class Appearance:
    """Estimates from one set of observations. A row is the mean of a place's pixels in an image, weighted by
    their number.

    Args:
        observations: the pixels.
        seed: seed for drawing places where there are too many.
    """

    def __init__(self, observations: Observations, seed: int = 0) -> None:
        o = observations
        self._cameras, self._frames = int(o.camera.max()) + 1, int(o.frame.max()) + 1
        size = CELL * float(np.median(o.footprint))
        place = boxes(o.rest, size, o.rest_normal)
        key = (place * self._frames + o.frame) * self._cameras + o.camera
        rows, row, count = np.unique(key, return_inverse=True, return_counts=True)
        drawn = np.random.default_rng(seed).permutation(place.max() + 1)
        share = min(1.0, _MOST_ROWS / len(rows))
        kept = drawn[rows // (self._frames * self._cameras)] < (place.max() + 1) * share

        def mean(values: np.ndarray) -> np.ndarray:
            return _mean(row, values)[kept]

        self._place = np.unique(rows[kept] // (self._frames * self._cameras), return_inverse=True)[1]
        self._frame, self._camera = rows[kept] // self._cameras % self._frames, rows[kept] % self._cameras
        self._weight = count[kept].astype(np.float64)
        self._colour, self._shading, self._side = mean(o.colour), mean(o.shading), mean(o.to_camera_rest)
        mirrored = 2 * np.sum(o.normal * o.to_camera, axis=1, keepdims=True) * o.normal - o.to_camera
        self._highlights = mean(np.exp(_CONCENTRATION * (mirrored @ directions(_LOBES).T - 1)))
        rest, normal = mean(o.rest), mean(o.rest_normal)
        self._patch, self._region = boxes(rest, PATCH * size, normal), boxes(rest, REGION)
        self._residual = self._colour - self._place_mean(self._colour, np.ones(len(rest), dtype=bool))

    def normal(self) -> Estimate:
        """What the turning of the world normal explains beyond the place, in frames that were not fitted."""
        if self._frames < 3 or not np.abs(self._shading).max() > 1e-6:
            return UNKNOWN
        folds = self._frame * min(_FOLDS, self._frames) // self._frames
        return self._gain(self._shading, folds, given_normal=False)

    def view(self, given_normal: bool) -> Estimate:
        """What the mirrored view explains beyond place (and normal, if given), in cameras not fitted."""
        if self._cameras < 3:
            return UNKNOWN
        return self._gain(self._highlights, self._camera, given_normal)

    def frame(self, given_normal: bool) -> tuple[Estimate, Estimate]:
        """What the frame explains beyond the place, and beyond the normal if given.

        The estimate is the covariance of what two cameras see at one place in one frame, minus that of what
        they see in two frames, from sides as far apart.

        Returns:
            all of it, and the part that changes within a patch. Shading is constant across a patch, so this
            part means that something moves along the surface.
        """
        if self._frames < 2 or self._cameras < 2:
            return UNKNOWN, UNKNOWN
        residual = self._residual
        if given_normal:
            everything = np.ones(len(residual), dtype=bool)
            residual = residual - self._predicted(
                self._shading, self._colour - residual, residual, everything, everything, shading=True)
        fine, coarse = self._shared(residual, self._place), self._shared(residual, self._patch)
        return fine, Estimate(fine.value - coarse.value, float(np.hypot(fine.error, coarse.error)))

    def _gain(self, added: np.ndarray, folds: np.ndarray, given_normal: bool) -> Estimate:
        """How much `added` reduces the squared error of each fold when fitted on the others."""
        saved = np.full(len(folds), np.nan)
        for fold in np.unique(folds):
            train = folds != fold
            test = ~train & np.isin(self._place, self._place[train])
            mean = self._place_mean(self._colour, train)
            residual = self._colour - mean
            if given_normal:
                residual = residual - self._predicted(self._shading, mean, residual, train, test | train,
                                                      shading=True)
            predicted = self._predicted(added, mean, residual, train, test, shading=added is self._shading)
            saved[test] = np.mean(residual[test] ** 2 - (residual - predicted)[test] ** 2, axis=1)
        known = np.isfinite(saved)
        if not known.any():
            return UNKNOWN
        return _estimate(saved[known], self._weight[known],
                         (self._camera * self._frames + self._frame)[known])

    def _predicted(self, x: np.ndarray, mean: np.ndarray, residual: np.ndarray, train: np.ndarray,
                   test: np.ndarray, shading: bool) -> np.ndarray:
        """(R, 3) the residual as predicted from `x` (R, K), by ridge regression on `train` in each region.

        Args:
            mean: (R, 3) mean colour of the place, which multiplies `x` if it is shading.
        """
        out = np.zeros_like(residual)
        centred = x - self._place_mean(x, train)
        for channel in range(3):
            inputs = centred * mean[:, channel : channel + 1] if shading else centred
            for region in np.unique(self._region[test]):
                here = self._region == region
                fit, use = np.flatnonzero(here & train), np.flatnonzero(here & test)
                a = inputs[fit]
                gram = (a * self._weight[fit, None]).T @ a + _RIDGE * np.eye(a.shape[1])
                target = a.T @ (self._weight[fit] * residual[fit, channel])
                out[use, channel] = inputs[use] @ np.linalg.solve(gram, target)
        return out

    def _place_mean(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(R, K) for every row the mean of its place over the rows selected; zero for a place without any."""
        count = int(self._place.max()) + 1
        total = _sum(self._place[rows], values[rows] * self._weight[rows, None], count)
        weight = np.bincount(self._place[rows], self._weight[rows], minlength=count)
        return (total / np.maximum(weight, 1e-9)[:, None])[self._place]

    def _shared(self, residual: np.ndarray, place: np.ndarray) -> Estimate:
        """The covariance of two cameras' rows at one place in one frame, minus that in two frames."""
        order = np.lexsort((self._camera, self._frame, place))
        starts = np.flatnonzero(np.diff(place[order], prepend=-1))
        bins = int(2 / _BIN) + 1
        across_sum, across_weight = np.zeros(bins), np.zeros(bins)
        pairs: list[tuple[np.ndarray, ...]] = []
        for rows in np.split(order, starts[1:]):
            weight = self._weight[rows, None] * self._weight[rows]
            product = residual[rows] @ residual[rows].T / 3
            angle = ((self._side[rows] @ self._side[rows].T + 1) / _BIN).astype(int).clip(0, bins - 1)
            other_camera = self._camera[rows][:, None] != self._camera[rows]
            same_frame = self._frame[rows][:, None] == self._frame[rows]
            across = other_camera & ~same_frame
            across_sum += np.bincount(angle[across], (weight * product)[across], minlength=bins)
            across_weight += np.bincount(angle[across], weight[across], minlength=bins)
            i, j = np.nonzero(other_camera & same_frame)
            pairs.append((rows[i], angle[i, j], weight[i, j], product[i, j]))
        row, angle, weight, product = (np.concatenate(column) for column in zip(*pairs, strict=True))
        known = across_weight[angle] > 0
        if not known.any():
            return UNKNOWN
        excess = product - (across_sum / np.maximum(across_weight, 1e-9))[angle]
        cluster = self._region * self._frames + self._frame
        return _estimate(excess[known], weight[known], cluster[row[known]])


def directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors, evenly distributed over the sphere (Fibonacci spiral)."""
    i = np.arange(count) + 0.5
    y, phi = 1 - 2 * i / count, i * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - y * y) * np.cos(phi), y, np.sqrt(1 - y * y) * np.sin(phi)], axis=1)


def boxes(points: np.ndarray, size: float, normals: np.ndarray | None = None) -> np.ndarray:
    """(N,) int index of each point's box of that size, separate for each main axis of the normals."""
    key = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    if normals is not None:
        axis = np.abs(normals).argmax(axis=1)
        side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
        key = np.concatenate([key, side[:, None]], axis=1)
    return np.unique(key, axis=0, return_inverse=True)[1].ravel()


def _sum(groups: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    return np.stack([np.bincount(groups, column, minlength=count) for column in values.T], axis=1)


def _mean(groups: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(G, K) means of (N, K) values by group."""
    count = np.bincount(groups)
    return _sum(groups, values, len(count)) / count[:, None]


def _estimate(values: np.ndarray, weights: np.ndarray, clusters: np.ndarray) -> Estimate:
    """The weighted mean, and its cluster-robust standard error (sandwich estimator)."""
    mean = float(np.average(values, weights=weights))
    index = np.unique(clusters, return_inverse=True)[1]
    sums = np.bincount(index, weights * (values - mean))
    if len(sums) < 2:
        return Estimate(mean, float("inf"))
    return Estimate(mean, float(np.sqrt(np.sum(sums**2) * len(sums) / (len(sums) - 1)) / weights.sum()))
