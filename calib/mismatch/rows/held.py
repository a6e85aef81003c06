"""Turns of a sensor that a hand holds: from its mean attitude in one rest to that in the next.

Gravity tells the mean attitude in a rest. A turn begins where the hand has swayed to, which is off
that by milliradians: many times what a gyroscope errs by in a turn. But it saw the sensor sway.
With ``s(t)`` the share of a rest that has passed and w its rate, the angle from the mean attitude
to that at the end, and to that at the beginning, is

    end = integral of s w dt,    begin = integral of (s - 1) w dt

A bias is in w as well. So of each cell of a rest the rate about its mean counts, which tells of no
bias; and the mean rate, which may be a bias or a turn, counts as what is unknown: a hand that
turned on average has left that in the cell's mean as well as in the closures beside it, with the
weights ``integral of s dt`` and ``integral of (s - 1) dt`` in the cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

from calib.mismatch.rows.closure import Closures, across
from calib.mismatch.rows.grid import Grid
from calib.rotation import skew
from calib.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Ends:
    """How a sensor that is held has turned from its mean attitude to either end of a rest.

    Parameters
    ----------
    turned : (poses, 3) array, rad
        By the rates about the mean of their cells; of either end the same.
    weights : (2, cells) array, s
        What the mean rate of each cell counts in the angle to the end, and to the beginning.
    spread : (poses,) array, s²
        What the variance of a sample counts in that of ``turned``.
    held : (poses,) array
        One in those that are, or else zero, as all of these are then.
    """

    turned: FloatArray
    weights: FloatArray
    spread: FloatArray
    held: FloatArray

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, grid: Grid) -> Ends:
        """Return how far the rests of a grid are turned at their ends, as the gyroscope says it."""
        still, poses = np.flatnonzero(grid.pose >= 0), grid.n_poses
        pose, count, rate = grid.pose[still], grid.count[still], grid.gyro[still]
        cell = (np.cumsum(grid.is_rest) - 1)[grid.segment[still]]
        number = np.bincount(cell, count)
        step = np.ptp(grid.interval[grid.is_rest], axis=1) / np.maximum(number - 1, 1)
        lasts = count * step[cell]
        passed, whole = np.cumsum(lasts), np.bincount(pose, lasts, poses)
        begins = np.append(0.0, np.cumsum(whole))[pose]
        share = (passed - 0.5 * lasts - begins) / whole[pose]
        time, middle = number * step, np.bincount(cell, count * share) / number
        mean = np.stack([np.bincount(cell, count * r) / number for r in rate.T], axis=1)
        every = np.zeros(poses, bool) if grid.held is None else grid.held.poses
        held = every.astype(np.float64)
        about = lasts * (share - middle[cell]) * held[pose]
        apart = (about[:, None] * (rate - mean[cell])).T
        return cls(
            np.stack([np.bincount(pose, r, poses) for r in apart], axis=1),
            np.stack((time * middle, time * (middle - 1.0))) * held[grid.before[grid.is_rest]],
            np.asarray(np.bincount(pose, np.square(about) / count, poses), np.float64),
            held,
        )


@dataclass(frozen=True, eq=False)
class HeldTurns:
    """What k turns of a held sensor feel of how it sways in the rests on either side.

    Parameters
    ----------
    grid : Grid
    felt : (2, k, 5, 3) array
        What small turns by a gyroscope's axes, at the end of the rest before and at the beginning
        of that after, do to the closures.
    turned : (k, 5) array
        What the rates about the mean of each cell say that the closures are off by.
    """

    grid: Grid
    felt: FloatArray
    turned: FloatArray

    @classmethod
    def of(
        cls,
        grid: Grid,
        closed: Closures,
        up: FloatArray,
        inverse: FloatArray,
        rate: FloatArray,
    ) -> HeldTurns:
        """Return those of closures between poses, of which `up` is (poses, 3).

        ``inverse`` makes rates of what the gyroscope's axes say, and `rate` (n, 3) are the true
        ones at the points of all turns: half a sample interval lies between the last sample of a
        rest, which counts for as long on either side of it, and the first of a turn.
        """
        ends = Ends.of(grid)
        felt, turned = [], np.zeros((len(closed.residual), 5))
        beside = _half_a_sample(grid, rate)
        for part, k, angle in zip(
            (closed.before, closed.after), cls._poses(grid), beside, strict=True
        ):
            # A small turn moves up by its product with it.
            own = part @ np.swapaxes(across(up[k]), 1, 2) @ skew(up[k])
            told = ends.turned[k] @ inverse.T + angle * ends.held[k, None]
            turned += np.einsum("krc,kc->kr", own, told)
            felt.append(own @ inverse)
        return cls(grid, np.stack(felt), turned)

    def covariance(self, variance: FloatArray) -> FloatArray:
        """Return what white noise of a rate's samples, and a hand's velocity, add, (k, 5, 5).

        ``variance`` (3,) is that of a sample.
        """
        held = self.grid.held
        assert held is not None
        spread = Ends.of(self.grid).spread
        out = np.zeros((self.felt.shape[1], 5, 5))
        for part, k in zip(self.felt, self._poses(self.grid), strict=True):
            each = part * np.sqrt(spread[k, None, None] * variance)
            out += each @ np.swapaxes(each, 1, 2)
            out[:, [2, 3, 4], [2, 3, 4]] += held.velocity[k, None]
        return out

    def responses(self, ends: IntArray, number: int) -> tuple[sparse.csr_matrix, ...]:
        """Return what rows feel of the mean rate about a gyroscope's axis in each cell.

        Three sparse (number, cells) matrices; ``ends`` (k, 5) are the rows of the closures.
        """
        place = self.grid.before[self.grid.is_rest]
        out = [sparse.csr_matrix((number, len(place)))] * 3
        weights = Ends.of(self.grid).weights
        for part, weight, pose in zip(self.felt, weights, self._poses(self.grid), strict=True):
            turn, cell = np.nonzero(pose[:, None] == place)
            at = ends[turn].ravel(), np.repeat(cell, ends.shape[1])
            for c in range(3):
                values = (part[turn, :, c] * weight[cell, None]).ravel()
                out[c] = out[c] + sparse.csr_matrix((values, at), shape=out[c].shape)
        return tuple(out)

    @staticmethod
    def _poses(grid: Grid) -> tuple[IntArray, IntArray]:
        """Return the poses before and after each turn."""
        turns = ~grid.is_rest
        return grid.before[turns], grid.after[turns]


def _half_a_sample(grid: Grid, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far it turns in half an interval before, and back after, each turn, (k, 3).

    Rates at their middles are from lines through the first, and the last, two samples.
    """
    spans = grid.turns[1]
    out = []
    for own, next_, sign in (
        (spans.start, spans.start + 1, 1.0),
        (spans.last, spans.last - 1, -1.0),
    ):
        lasts = 0.5 * np.abs(spans.time[next_] - spans.time[own])
        out.append(sign * lasts[:, None] * (1.25 * rate[own] - 0.25 * rate[next_]))
    return out[0], out[1]
