"""Which factor, or which axes, make the gyroscope agree with gravity on what turns did.

What a turn does to gravity's direction must agree with the integral of the rate, ``u_before =
R(w / factor) u_after``. Of the factors that go with a confusion of units, the one with which it
does is found; of the signed permutations of the axes, likewise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.closure import TurnSteps, closure_residual
from calib.effects.axis_error import ORDERS, signed_permutation
from calib.poses import Poses
from calib.recording import Recording
from calib.rotation import cumulative_quat_segments, mat_from_quat, quat_from_rotvec
from calib.turns import find_holes, find_turns, overlapping
from calib.types import FloatArray, IntArray

DEGREE = np.pi / 180

GYRO_FACTORS = {
    1 / DEGREE: "the gyroscope is in deg/s",
    1000 / DEGREE: "the gyroscope is in mdeg/s",
    **{
        per_second: f"the time is in {unit}, or the gyroscope in {_rate}"
        for unit, _rate, per_second in (("ms", "mrad/s", 1e3), ("µs", "µrad/s", 1e6))
    },
    1e9: "the time is in ns",
    DEGREE: "the gyroscope was in rad/s already and was converted from deg/s again",
    **{
        scale: f"the gyroscope's full scale is {_times} what was assumed"
        for scale, _times in (
            (0.125, "8 times"),
            (0.25, "4 times"),
            (0.5, "twice"),
            (2.0, "half"),
            (4.0, "a quarter of"),
            (8.0, "an eighth of"),
        )
    },
    **{
        counts / DEGREE: f"the gyroscope is in counts of {counts} LSB/(deg/s)"
        for counts in (16.4, 32.8, 65.5, 131.0)
    },
}
"""Measured over true, rad/s being declared, and what such a factor means."""

OWN_SCALE = (0.7, 1.4)
"""Measured over true; outside of this it is not a sensor's own error, however poor it is."""
MOVED = 20 * DEGREE
"""By how much a turn must tilt the sensor to tell anything of the gyroscope's unit."""
AGREE = 20 * DEGREE
"""Closure that an uncalibrated sensor reaches: 10 % of a half turn."""
ENOUGH = 12
"""Turns."""
MOST = 0.7
"""Of the turns must close: two axes swapped leave turns about the third as they are."""
STRAIGHT = 2.0
"""Times as far as it tilts a turn may go: about an axis that is halfway to gravity's, or by a hand
that comes back a little."""
FEWEST = 6
"""Turns that are not all explained by chance if factors that nobody knows are tried."""
AXIS_MAPS = [signed_permutation(number) for number in range(len(ORDERS))]


@dataclass(frozen=True, eq=False)
class Closure:
    """The turns that tilted the sensor: what the gyroscope says they did, and what gravity did.

    Parameters
    ----------
    angle : (n, 3) array, rad
        Integral of the rate over each step, bias taken out; `first` as in `TurnSteps`.
    before, after : (m, 3) arrays
        Direction of gravity at both ends of each turn.
    interval : (m, 2) array, s
    lean : float, rad
        By how far the directions at both ends may be off together: where an accelerometer's bias
        makes ``|a|`` vary by a share either way from rest to rest, each leans by as much.
    """

    angle: FloatArray
    first: IntArray
    before: FloatArray
    after: FloatArray
    interval: FloatArray
    lean: float = 0.0

    @classmethod
    def of(cls, recording: Recording, poses: Poses) -> Closure | None:
        """Return the turns of a recording, or None if none tilted the sensor without a gap."""
        turns = find_turns(recording, poses)
        assert recording.lost is not None
        norm = np.linalg.norm(poses.accel, axis=1, keepdims=True)
        up = poses.accel / np.where(norm > 0, norm, 1.0)
        before, after = up[turns.before], up[turns.after]
        tilt = np.linalg.norm(closure_residual(before, after), axis=1)
        lost = np.concatenate([[0], np.cumsum(recording.lost)])
        whole = lost[turns.stop] == lost[turns.start + 1]
        whole &= ~overlapping(turns.interval, find_holes(recording))
        which = np.flatnonzero((tilt > MOVED) & whole)
        if not which.size:
            return None
        # A dozen are enough; the shortest say most, since least drifts into them.
        shortest = np.argsort((turns.stop - turns.start)[which], kind="stable")[:ENOUGH]
        which = np.sort(which[shortest])
        steps = TurnSteps.of(recording, turns.select(which))
        angle = steps.angle - np.median(poses.gyro, axis=0) * steps.step[:, None]
        lean = float(np.ptp(norm) / norm.mean())
        return cls(angle, steps.first, before[which], after[which], turns.interval[which], lean)

    def __len__(self) -> int:
        return len(self.before)

    def error(self, matrix: FloatArray) -> float:
        """Return the angle, rad, by which most turns miss gravity if ``matrix @ rate`` is true."""
        return float(np.quantile(self._errors(matrix), MOST))

    def _errors(self, matrix: FloatArray) -> FloatArray:
        """Return the angle, rad, by which each turn does, (m,)."""
        quat = cumulative_quat_segments(quat_from_rotvec(self.angle @ matrix.T), self.first)
        mat = mat_from_quat(quat[self.first[1:] - 1])
        predicted = np.einsum("mij,mj->mi", mat, self.after)
        return np.asarray(np.linalg.norm(closure_residual(self.before, predicted), axis=1))

    @cached_property
    def missed(self) -> float:
        """The angle, rad, by which gravity misses in most turns with the rate as it is."""
        return self.error(np.eye(3))

    @cached_property
    def _explained(self) -> tuple[float, int | None, FloatArray]:
        """The factor, the only axis that has it (or None), and the axes that explain turns best.

        Axes are columns of the file, signed.
        """
        plain = 1.0, None, np.eye(3)
        if self.missed < AGREE:
            return plain
        enough = min(AGREE, self.missed / 3)
        by_factor = {factor: self.error(np.eye(3) / factor) for factor in GYRO_FACTORS}
        factor = min(by_factor, key=by_factor.__getitem__)
        maps = [self.error(mat) for mat in AXIS_MAPS]
        best = int(np.argmin(maps))
        # One or two turns fit some axes or other; a unit is the simpler explanation, unless there
        # was more motion in them than they tilted by, which ends anywhere by some factor or other.
        known = self._straight(factor) if len(self) < 3 else by_factor[factor] < 1.5 * maps[best]
        if by_factor[factor] < enough and known:
            return factor, None, np.eye(3)
        if len(self) >= 3 and maps[best] < enough:
            return 1.0, None, AXIS_MAPS[best]
        if len(self) < FEWEST:
            return plain
        by_axis = {
            (factor, c): self.error(np.diag(np.where(np.arange(3) == c, 1 / factor, 1.0)))
            for factor in GYRO_FACTORS
            for c in range(3)
        }
        factor, odd = min(by_axis, key=by_axis.__getitem__)
        if by_axis[factor, odd] < enough:
            return factor, odd, np.eye(3)
        if self._own:
            return plain
        unnamed = {float(f): self.error(np.eye(3) / f) for f in self._sizes()}
        factor = min(unnamed, key=unnamed.__getitem__)
        return (factor, None, np.eye(3)) if unnamed[factor] < enough else plain

    def _straight(self, factor: float) -> bool:
        """Whether turns are hardly longer than they tilt by, if rates are too large by a factor."""
        steps = np.linalg.norm(self.angle, axis=1) / factor
        return bool((np.add.reduceat(steps, self.first[:-1]) < STRAIGHT * self._tilt).all())

    @property
    def _tilt(self) -> FloatArray:
        """The angle by which each turn tilted, (m,) rad."""
        return np.asarray(np.linalg.norm(closure_residual(self.before, self.after), axis=1))

    @cached_property
    def _own(self) -> bool:
        """Whether a scale factor that is the sensor's own, if a poor one, explains the turns."""
        low, high = OWN_SCALE
        return any(self.error(np.eye(3) / f) < AGREE for f in np.geomspace(low**2, high**2, 15))

    def _sizes(self) -> FloatArray:
        """Return factors that would make turns as large as gravity says, or up to 3 times so."""
        total = np.add.reduceat(self.angle, self.first[:-1], axis=0)
        ratio = float(np.median(np.linalg.norm(total, axis=1) / self._tilt))
        return np.asarray((ratio or 1.0) * np.geomspace(1 / 3, 1.1, 60))

    @property
    def agrees(self) -> bool:
        """Whether most turns agree with gravity, by some factor and axes at least."""
        factor, _, axes = self._explained
        known = factor != 1.0 or not np.array_equal(axes, np.eye(3))
        return self.missed < self._off or known or self._own

    @property
    def disagreeing(self) -> FloatArray:
        """The turns that miss gravity by more than a sensor's errors, (k, 2) s."""
        return self.interval[self._errors(np.eye(3)) > self._off]

    @property
    def _off(self) -> float:
        """By how much a sensor that nobody has calibrated may miss gravity, rad."""
        return AGREE + self.lean

    @property
    def factor(self) -> float:
        """Measured over true rate; 1 unless another factor explains the turns."""
        return self._explained[0]

    @property
    def channel(self) -> int | None:
        """The only axis (0 to 2) that has this factor; None if all have it."""
        return self._explained[1]

    @property
    def axes(self) -> FloatArray:
        """The signed permutation that makes the rate agree with gravity; identity if none does."""
        return self._explained[2]
