"""How a hand that holds a sensor sways, learnt from what gravity and rates both say of it.

A change of angle moves gravity across the accelerometer, and is the sum of the gyroscope's rate.
The noise of either is not in the other, so that on average the product of both is the square of
what the sensor did, whatever it is small beside. By the time d between two moments::

    E[across(t + d) - across(t)] . [path(t + d) - path(t)] = 2 g² V(d)
    V(d) = q (tau (1 - exp(-d / tau)) + steady d²)

with V the variance about one axis, as `lean` has it: q in rad²/s; a walk has no tau.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.bumps import UNSURE
from calib.mismatch.rows.grid import REST_STEP, Grid
from calib.mismatch.rows.lean import WALK, Sway
from calib.types import FloatArray, IntArray

SURE = 5.0
"""Standard errors by which gravity has turned as a rate says, or has not as it should have."""

LAGS = (2, 4, 8, 16, 32, 64)
"""Points of the grid between which angles are compared: half a second to sixteen."""

FEWEST = 3
"""Times that a lag fits into the rests, at least."""

BACK = (0.5, 1.0, 2.0, 4.0, 8.0)
"""s in which a hand may come back to where it was."""

BETTER = 4.0
"""Of chi-squared, by which it must come back more likely than not: two standard deviations."""


def how_it_sways(
    grid: Grid, points: Sequence[IntArray], still: FloatArray, *, after: float
) -> Sway:
    """Return how a sensor sways in its rests; `WALK` where they do not tell.

    Parameters
    ----------
    grid : Grid
    points : arrays of int
        The points of each rest, in the order of time.
    still : (rests, 3) array, rad/s
        What the gyroscope would say in each if nothing turned.
    after : float, s
        From where on a rest counts.
    """
    from scipy.optimize import nnls  # only what sways needs it

    sums = np.zeros((len(LAGS), 3))
    for own, zero in zip(points, still, strict=True):
        sums += _products(grid, own, zero, after)
    told = sums[:, 0] >= FEWEST
    number, total, square = sums[told].T
    if len(number) < 2:
        return WALK
    seconds = REST_STEP * np.array(LAGS)[told]
    value = total / number
    # A product scatters about its mean, of which as many are independent as there is time for.
    scatter = np.maximum(square / number - np.square(value), 1e-30)
    weight = np.sqrt(number / scatter)
    best, least = WALK, np.inf
    for back in (np.inf, *BACK):
        wanders = seconds if np.isinf(back) else -back * np.expm1(-seconds / back)
        shape = np.stack((wanders, np.square(seconds)), axis=1)
        weighted = weight[:, None] * shape
        (level, steady), left = nnls(weighted, weight * value)
        if level > 0 and left**2 < least - BETTER * (best.expected > 0 and np.isinf(best.back)):
            # What is slower than rests last is known worst, and taken for as large as it may be.
            steady += float(np.sqrt(np.linalg.inv(weighted.T @ weighted)[1, 1]))
            best, least = Sway(float(level), back, float(steady / level)), left**2
    return best


def follows(seen: float, wanted: float, *, sure: float = SURE) -> bool:
    """Return whether gravity moved as a rate says: by so many standard errors, and as it should."""
    return seen > sure and wanted / UNSURE < seen < wanted * UNSURE


def follow(
    time: FloatArray, force: FloatArray, rate: FloatArray, noise: FloatArray, *, order: int = 1
) -> tuple[float, float]:
    """Return by how many standard errors gravity moved as small turns say, and how far it should.

    Parameters
    ----------
    time : (n,) array, s
    force, rate : (n, 3) arrays
        What a sensor sees that hardly turns; the rate without its bias.
    noise : (n, 3) or (3,) array
        Standard deviation of the forces.
    order : int
        Of the polynomial of time that is no motion: an offset, or beside it what a bias adds.
    """
    trend = np.vander(time - time[0], order + 1)
    path = path_of(time, force, rate) / noise
    scale = np.broadcast_to(noise, path.shape)[:, :1]
    trend = trend / scale
    left, wanted = (
        v - trend @ np.linalg.lstsq(trend, v, rcond=None)[0] for v in (force / noise, path)
    )
    size = float(np.linalg.norm(wanted))
    return float((left * wanted).sum()) / max(size, 1e-9), size


def path_of(time: FloatArray, force: FloatArray, rate: FloatArray) -> FloatArray:
    """Return how gravity would move across an accelerometer by the sum of small turns, (n, 3)."""
    turned = np.diff(time)[:, None] * 0.5 * (rate[1:] + rate[:-1])
    angle = np.concatenate((np.zeros((1, 3)), np.cumsum(turned, axis=0)))
    return np.cross(force.mean(axis=0), angle)


def _products(grid: Grid, own: IntArray, zero: FloatArray, after: float) -> FloatArray:
    """Return how many products of one rest there are by lag, their sum, and that of squares."""
    out = np.zeros((len(LAGS), 3))
    own = own[grid.time[own] >= grid.time[own[0]] + after]
    if len(own) < 2:
        return out
    time, force, rate = grid.time[own], grid.accel[own], grid.gyro[own] - zero
    path = path_of(time, force, rate)
    size = 2.0 * float(np.square(force.mean(axis=0)).sum())
    for k, lag in enumerate(LAGS):
        if lag < len(own):
            seen, wanted = (v[lag:] - v[:-lag] for v in (force, path))
            product = (seen * wanted).sum(axis=1) / size
            moments = np.array([1.0, product.mean(), np.square(product).mean()])
            out[k] = moments * len(own) / lag
    return out
