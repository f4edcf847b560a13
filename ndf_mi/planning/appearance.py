"""What colours on the body's surface depend on, asked of the images by small linear models that must predict what they have not seen.

Every pixel shows a place on the body. What a place looks like on average needs nothing but the place. What is left is asked to follow
from the turning of the surface's world normal, from the direction that it mirrors towards the camera, or from the frame. The answer is how
much of the mean squared error in sRGB that explains *where it was not fitted*: what explains nothing comes out at zero or below.

The body is only near the surface that is seen, so that cameras which look at one place of the body from different sides see different
places of the cloth. That error is not shared by a region, and in the estimate by frames it is the same for frames that are compared;
so it makes estimates less sure, not larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.planning.observations import Observations

#: Edge of a cell, which is one place, in pixels' footprints; of a patch, across which shading is one value, in cells; of a region, across
#: which one material is assumed to answer to light and view alike, in metres.
CELL, PATCH, REGION = 2.0, 3, 0.3
#: The ridge: the variance of a pixel's colour about its prediction, some 1e-2, to that of a regressor's weight, a tenth squared. Regressors
#: are not scaled: one that the fitted images hardly vary in must not get a large weight.
_RIDGE = 1.0
#: Parts that frames are divided into to be left out in turn.
_FOLDS = 6
#: Directions that highlights are made of, and their concentration: lobes of about 30 degrees, as far as neighbours are apart.
_LOBES, _CONCENTRATION = 32, 8.0
#: Rows that estimates are made from at most: the places are drawn at random.
_MOST = 40_000
#: Width of the bins, in cosines, of the angle between the sides that two cameras look at a place from.
_BIN = 0.1


@dataclass(frozen=True)
class Estimate:
    """A mean squared difference in sRGB (mean over channels), and its standard error; the error of what was not estimated is infinite."""

    value: float
    error: float

    @property
    def sure(self) -> bool:
        """Whether it is above zero by more than two standard errors."""
        return self.value > 2 * self.error


#: What cannot be told from the images that there are.
UNTOLD = Estimate(0.0, float("inf"))


class Appearance:
    """Estimates from one set of observations: rows are the means of a place's pixels in an image, weighted by their number.

    Args:
        seen: the observations.
        seed: of the places drawn where there are too many.

    Attributes:
        spread: mean squared difference of a row from the mean of its place, all that any part could explain.
    """

    def __init__(self, seen: Observations, seed: int = 0) -> None:
        size = CELL * float(np.median(seen.footprint))
        place = boxes(seen.rest, size, seen.rest_normal)
        key = (place * seen.frames + seen.frame) * seen.cameras + seen.camera
        rows, row, count = np.unique(key, return_inverse=True, return_counts=True)
        drawn = np.random.default_rng(seed).permutation(place.max() + 1)
        kept = drawn[rows // (seen.frames * seen.cameras)] < (place.max() + 1) * min(1.0, _MOST / len(rows))

        def mean(values: np.ndarray) -> np.ndarray:
            return _mean(row, values)[kept]

        self._cameras, self._frames = seen.cameras, seen.frames
        self._place = np.unique(rows[kept] // (seen.frames * seen.cameras), return_inverse=True)[1]
        self._frame, self._camera = rows[kept] // seen.cameras % seen.frames, rows[kept] % seen.cameras
        self._weight = count[kept].astype(np.float64)
        self._colour, self._turned, self._aside = mean(seen.colour), mean(seen.turned), mean(seen.aside)
        mirrored = 2 * np.sum(seen.normal * seen.away, axis=1, keepdims=True) * seen.normal - seen.away
        self._highlights = mean(np.exp(_CONCENTRATION * (mirrored @ directions(_LOBES).T - 1)))
        rest, normal = mean(seen.rest), mean(seen.rest_normal)
        self._patch, self._region = boxes(rest, PATCH * size, normal), boxes(rest, REGION)
        self._left = self._colour - self._centre(self._colour, np.ones(len(rest), dtype=bool))
        self.spread = float(np.average(np.mean(self._left**2, axis=1), weights=self._weight))

    def normal(self) -> Estimate:
        """What the turning of the world normal explains beyond the place, in frames that were not fitted."""
        if self._frames < 3 or not np.abs(self._turned).max() > 1e-6:
            return UNTOLD
        folds = self._frame * min(_FOLDS, self._frames) // self._frames
        return self._gain(None, self._turned, folds)

    def view(self, given_normal: bool) -> Estimate:
        """What the mirrored direction explains beyond the place, and the normal if that is given, in cameras that were not fitted."""
        if self._cameras < 3:
            return UNTOLD
        return self._gain(self._turned if given_normal else None, self._highlights, self._camera)

    def frame(self, given_normal: bool) -> tuple[Estimate, Estimate]:
        """What the frame explains beyond the place, and the normal if that is given: in all, and the part of it that changes within a
        patch, which no change of shading across it does: something moves along the surface.

        The covariance of what two cameras see at one place in one frame, less that of what they see in two frames, from sides as far apart.
        """
        if self._frames < 2 or self._cameras < 2:
            return UNTOLD, UNTOLD
        left = self._left
        if given_normal:
            everything = np.ones(len(left), dtype=bool)
            left = left - self._predicted(self._turned, self._colour - left, left, everything, everything, shading=True)
        fine, coarse = self._shared(left, self._place), self._shared(left, self._patch)
        return fine, Estimate(fine.value - coarse.value, float(np.hypot(fine.error, coarse.error)))

    def _gain(self, given: np.ndarray | None, added: np.ndarray, folds: np.ndarray) -> Estimate:
        """How much smaller the squared error is with `added` than without, in each fold fitted on the others."""
        saved = np.full(len(folds), np.nan)
        for fold in np.unique(folds):
            train = folds != fold
            test = ~train & np.isin(self._place, self._place[train])
            mean = self._centre(self._colour, train)
            left = self._colour - mean
            if given is not None:
                left = left - self._predicted(given, mean, left, train, test | train, shading=True)
            more = self._predicted(added, mean, left, train, test, shading=added is self._turned)
            saved[test] = np.mean(left[test] ** 2 - (left - more)[test] ** 2, axis=1)
        told = np.isfinite(saved)
        if not told.any():
            return UNTOLD
        return _estimate(saved[told], self._weight[told], (self._camera * self._frames + self._frame)[told])

    def _predicted(self, x: np.ndarray, mean: np.ndarray, left: np.ndarray, train: np.ndarray, test: np.ndarray,
                   shading: bool) -> np.ndarray:
        """(R, 3) what `x` (R, K), times the place's `mean` colour if it is shading, says about `left`; fitted by region on `train`."""
        out = np.zeros_like(left)
        inside = x - self._centre(x, train)
        for channel in range(3):
            both = inside * mean[:, channel : channel + 1] if shading else inside
            for region in np.unique(self._region[test]):
                here = self._region == region
                fit, use = np.flatnonzero(here & train), np.flatnonzero(here & test)
                a = both[fit]
                gram = (a * self._weight[fit, None]).T @ a + _RIDGE * np.eye(a.shape[1])
                out[use, channel] = both[use] @ np.linalg.solve(gram, a.T @ (self._weight[fit] * left[fit, channel]))
        return out

    def _centre(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(R, K) the mean of its place, over these rows, for every row; zero for a place without any."""
        count = int(self._place.max()) + 1
        total = _sum(self._place[rows], values[rows] * self._weight[rows, None], count)
        weight = np.bincount(self._place[rows], self._weight[rows], minlength=count)
        return (total / np.maximum(weight, 1e-9)[:, None])[self._place]

    def _shared(self, left: np.ndarray, place: np.ndarray) -> Estimate:
        """The covariance of rows of one place and frame but different cameras, less what such pairs have in different frames."""
        order = np.lexsort((self._camera, self._frame, place))
        starts = np.flatnonzero(np.diff(place[order], prepend=-1))
        bins = int(2 / _BIN) + 1
        apart_sum, apart_weight = np.zeros(bins), np.zeros(bins)
        pairs: list[tuple[np.ndarray, ...]] = []
        for rows in np.split(order, starts[1:]):
            weight = self._weight[rows, None] * self._weight[rows]
            product = left[rows] @ left[rows].T / 3
            angle = ((self._aside[rows] @ self._aside[rows].T + 1) / _BIN).astype(int).clip(0, bins - 1)
            other_camera = self._camera[rows][:, None] != self._camera[rows]
            same_frame = self._frame[rows][:, None] == self._frame[rows]
            apart = other_camera & ~same_frame
            apart_sum += np.bincount(angle[apart], (weight * product)[apart], minlength=bins)
            apart_weight += np.bincount(angle[apart], weight[apart], minlength=bins)
            i, j = np.nonzero(other_camera & same_frame)
            pairs.append((rows[i], angle[i, j], weight[i, j], product[i, j]))
        row, angle, weight, product = (np.concatenate(column) for column in zip(*pairs, strict=True))
        told = apart_weight[angle] > 0
        if not told.any():
            return UNTOLD
        excess = product - (apart_sum / np.maximum(apart_weight, 1e-9))[angle]
        cluster = self._region * self._frames + self._frame
        return _estimate(excess[told], weight[told], cluster[row[told]])


def directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors, evenly over the sphere (the Fibonacci spiral)."""
    i = np.arange(count) + 0.5
    y, phi = 1 - 2 * i / count, i * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - y * y) * np.cos(phi), y, np.sqrt(1 - y * y) * np.sin(phi)], axis=1)


def boxes(points: np.ndarray, size: float, normals: np.ndarray | None = None) -> np.ndarray:
    """(N,) int numbers of the boxes of that size that points lie in, those with different main axes of the normal told apart."""
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
    """The weighted mean, and its standard error where values of one cluster may agree for any reason (the sandwich over clusters)."""
    mean = float(np.average(values, weights=weights))
    index = np.unique(clusters, return_inverse=True)[1]
    sums = np.bincount(index, weights * (values - mean))
    if len(sums) < 2:
        return Estimate(mean, float("inf"))
    return Estimate(mean, float(np.sqrt(np.sum(sums**2) * len(sums) / (len(sums) - 1)) / weights.sum()))
