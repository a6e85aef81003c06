"""Are the values in the unit that they claim? Physics decides, not statistics of the values.

- The specific force at rest is gravity: |a| near 9.8 m/s².
- What a turn does to gravity's direction must agree with the integral of the rate, ``u_before =
  R(w / factor) u_after``. Of the factors that go with a confusion of units, the one with which it
  does is found.

Sensors as they come from the factory are within 10-15 % of their scale and a few hundred mm/s²,
degrees per second, of zero; the tests leave room for three times that.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.closure import TurnSteps, closure_residual
from calib.errors import NoCommonMotionError, UnitError
from calib.faults import FASTEST
from calib.gravity import STANDARD_GRAVITY as G
from calib.poses import Poses
from calib.recording import TRIADS, Recording
from calib.rotation import cumulative_quat_segments, mat_from_quat, quat_from_rotvec
from calib.statics import find_poses
from calib.synchrony import gyro_delay
from calib.turns import find_turns
from calib.types import FloatArray, IntArray
from calib.unit_switch import Switch, unit_switches

DEGREE = np.pi / 180

ACCEL_FACTORS = {
    1 / G: "the accelerometer is in g",
    1000 / G: "the accelerometer is in mg",
    **{
        scale: f"the accelerometer's full scale is {_times} what was assumed"
        for scale, _times in (
            (0.25, "4 times"),
            (0.5, "twice"),
            (2.0, "half"),
            (4.0, "a quarter of"),
        )
    },
    **{
        2.0**power / G: f"the accelerometer is in counts of {2**power} LSB/g"
        for power in range(11, 16)
    },
}
"""Measured over true, m/s² being declared, and what such a factor means."""

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

AT_REST = (0.7, 1.4)
"""Times g; |a| at rest outside of this is not a sensor's error."""
IN_MOTION = (0.25, 6.0)
"""Times g; the median of |a| of a recording that only moves."""
NEAR = 0.35
"""How near, in log of the factor, a known confusion must be to be named."""
REMOVED = 0.03
"""Times g; |a| at rest below this means that gravity was taken out."""
MOVED = 20 * DEGREE
"""By how much a turn must tilt the sensor to tell anything of the gyroscope's unit."""
AGREE = 20 * DEGREE
"""Closure that an uncalibrated sensor reaches: 10 % of a half turn."""
ENOUGH = 12
"""Turns."""
MOST = 0.7
"""Of the turns must close: two axes swapped leave turns about the third as they are."""
FEWEST = 6
"""Turns that are not all explained by chance if factors that nobody knows are tried."""
ROUND = 0.1
"""By how much, relative to 1, ellipsoids miss squares of gravity that noise and axes explain."""


@dataclass(frozen=True)
class UnitFault:
    """One sensor that is not in its unit: ``measured = factor * true``.

    ``channel`` (0 to 2) is its only axis that is not, ``interval`` (s) the only part; None if all
    are not.
    """

    triad: str
    factor: float
    message: str
    channel: int | None = None
    interval: tuple[float, float] | None = None


def check_units(recording: Recording, poses: Poses | None = None) -> None:
    """Refuse a recording whose values are not in m/s² and rad/s, or not of one time.

    Parameters
    ----------
    recording : Recording
    poses : Poses, optional
        Its static poses, if they were found already.

    Raises
    ------
    UnitError
        With the factor that was found, and the unit that explains it.
    NoCommonMotionError
        If gyroscope and accelerometer do not show turns at the same time.
    """
    poses = find_poses(recording) if poses is None else poses
    faults = unit_faults(recording, poses, Closure.of(recording, poses))
    if faults:
        raise UnitError(
            "; ".join(fault.message for fault in faults)
            + ". Give the import profile that states the unit (--profile), or convert the values"
        )
    late = gyro_delay(recording)
    if late is not None:
        raise NoCommonMotionError(
            f"the gyroscope is {abs(late):.2f} s {'late' if late > 0 else 'early'} against the "
            "accelerometer: turns must be at the same time in both. Give both the stamps of one "
            "clock, or shift one"
        )


def unit_faults(recording: Recording, poses: Poses, closure: Closure | None) -> list[UnitFault]:
    """Return what is wrong with the units of a recording: nothing, or one fault a sensor.

    `closure` is that of its turns, as `Closure.of` returns it.
    """
    switched = [_switched(switch) for switch in unit_switches(recording)]
    if switched:
        # Of parts in unlike units the whole tells nothing.
        return switched
    found = [_accel_fault(recording, poses), _gyro_fault(recording, closure)]
    return [fault for fault in found if fault is not None]


def _switched(switch: Switch) -> UnitFault:
    triad, factor, (start, stop) = switch
    known = ACCEL_FACTORS if triad == "accel" else GYRO_FACTORS
    return UnitFault(
        triad,
        factor,
        f"from {start:.1f} to {stop:.1f} s the {TRIADS[triad]} is {factor:.4g} times as large as "
        f"in the rest of the recording{_name(factor, known)} there",
        interval=switch.interval,
    )


def _accel_fault(recording: Recording, poses: Poses) -> UnitFault | None:
    if len(poses):
        low, high = AT_REST
        norm = np.linalg.norm(poses.accel, axis=1)
        where = f"|a| at rest is {np.median(norm):.4g} m/s²"
    else:
        low, high = IN_MOTION
        norm = np.linalg.norm(recording.accel, axis=1)
        where = f"the median of |a| is {np.median(norm):.4g} m/s²"
    factor = float(np.median(norm)) / G
    gains = _gains(poses.accel)
    if gains is not None and (odd := _odd(gains)) is not None:
        factor = float(gains[odd])
        return UnitFault(
            "accel",
            factor,
            f"accelerometer {'xyz'[odd]} measures {factor * G:.4g} m/s² of gravity, expected "
            f"{G:.2f}, a factor of {factor:.4g}{_name(factor, ACCEL_FACTORS)}",
            odd,
        )
    if low <= factor <= high:
        return None
    if factor < REMOVED:
        return UnitFault(
            "accel",
            factor,
            f"{where}, expected {G:.2f}: gravity was taken out of it; calibration needs the "
            "accelerometer's own output",
        )
    return UnitFault(
        "accel",
        factor,
        f"{where}, expected {G:.2f}, a factor of {factor:.4g}{_name(factor, ACCEL_FACTORS)}",
    )


def _gains(accel: FloatArray) -> FloatArray | None:
    """Return the gain of each axis, (3,): semi-axes of the ellipsoid of (n, 3) poses, over g.

    None if the poses do not lie on one that they determine.
    """
    if len(accel) < 9:
        return None
    scale = np.abs(accel).max(axis=0)
    if not scale.all():
        return None
    unit = accel / scale
    design = np.hstack((np.square(unit), unit))
    if np.linalg.cond(design) > 30:
        return None
    found = np.linalg.lstsq(design, np.ones(len(unit)), rcond=None)[0]
    square, linear = found[:3], found[3:]
    if (square <= 0).any() or np.std(design @ found - 1) > ROUND:
        return None
    size = 1 + np.sum(np.square(linear) / (4 * square))
    return np.asarray(scale * np.sqrt(size / square) / G)


def _odd(gains: FloatArray) -> int | None:
    """Return the one axis of which the gain is not that of a sensor; None if there is not one."""
    low, high = AT_REST
    wrong = np.flatnonzero((gains < low) | (gains > high))
    return int(wrong[0]) if len(wrong) == 1 else None


def _gyro_fault(recording: Recording, closure: Closure | None) -> UnitFault | None:
    if closure is not None:
        factor, odd = closure.factor, closure.channel
        if factor == 1.0:
            return None
        what = "the gyroscope" if odd is None else f"gyroscope {'xyz'[odd]}"
        return UnitFault(
            "gyro",
            factor,
            f"turns are {factor:.4g} times as large by {what} as by the direction of "
            f"gravity{_name(factor, GYRO_FACTORS)}",
            odd,
        )
    rate = np.linalg.norm(recording.gyro - np.median(recording.gyro, axis=0), axis=1)
    fast = float(np.quantile(rate, 0.99))
    if fast > FASTEST:
        return UnitFault(
            "gyro",
            1 / DEGREE,
            f"rates reach {fast:.4g} rad/s, more than any MEMS gyroscope measures; perhaps they "
            "are in deg/s",
        )
    return None


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
    """

    angle: FloatArray
    first: IntArray
    before: FloatArray
    after: FloatArray
    interval: FloatArray

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
        which = np.flatnonzero((tilt > MOVED) & whole)
        if not which.size:
            return None
        # A dozen are enough; the shortest say most, since least drifts into them.
        shortest = np.argsort((turns.stop - turns.start)[which], kind="stable")[:ENOUGH]
        which = np.sort(which[shortest])
        steps = TurnSteps.of(recording, turns.select(which))
        angle = steps.angle - np.median(poses.gyro, axis=0) * steps.step[:, None]
        return cls(angle, steps.first, before[which], after[which], turns.interval[which])

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
        # One or two turns fit some axes or other; a unit is the simpler explanation.
        if by_factor[factor] < enough and (len(self) < 3 or by_factor[factor] < 1.5 * maps[best]):
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

    @cached_property
    def _own(self) -> bool:
        """Whether a scale factor that is the sensor's own, if a poor one, explains the turns."""
        low, high = AT_REST
        return any(self.error(np.eye(3) / f) < AGREE for f in np.geomspace(low**2, high**2, 15))

    def _sizes(self) -> FloatArray:
        """Return factors that would make turns as large as gravity says, or up to 3 times so."""
        total = np.add.reduceat(self.angle, self.first[:-1], axis=0)
        tilt = np.linalg.norm(closure_residual(self.before, self.after), axis=1)
        ratio = float(np.median(np.linalg.norm(total, axis=1) / tilt))
        return np.asarray((ratio or 1.0) * np.geomspace(1 / 3, 1.1, 60))

    @property
    def agrees(self) -> bool:
        """Whether most turns agree with gravity, by some factor and axes at least."""
        factor, _, axes = self._explained
        known = factor != 1.0 or not np.array_equal(axes, np.eye(3))
        return self.missed < AGREE or known or self._own

    @property
    def disagreeing(self) -> FloatArray:
        """The turns that miss gravity by more than a sensor's errors, (k, 2) s."""
        return self.interval[self._errors(np.eye(3)) > AGREE]

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


def _signed_permutations() -> list[FloatArray]:
    signs = itertools.product((1.0, -1.0), repeat=3)
    orders = itertools.permutations(range(3))
    return [
        np.diag(sign) @ np.eye(3)[list(order)] for order, sign in itertools.product(orders, signs)
    ]


AXIS_MAPS = _signed_permutations()


def _name(factor: float, known: dict[float, str]) -> str:
    """Return what a factor means, if it is near one that is known."""
    values = np.array(list(known))
    distance = np.abs(np.log(factor / values))
    nearest = int(np.argmin(distance))
    return f": {list(known.values())[nearest]}" if distance[nearest] < NEAR else ""
