"""From a recording of a device to its `Calibration`: poses, accelerometer, turns, gyroscope."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.linalg import block_diag

from calib import faults
from calib.calibration import (
    Calibration,
    Gravity,
    Noise,
    PoseTable,
    Provenance,
    TemperatureRange,
    TriadSummary,
)
from calib.errors import InsufficientMotionError
from calib.fit import Exclusion, Fit
from calib.gravity import EARTH
from calib.measured import measured
from calib.model import PARAMETER_UNITS, SensorModel, Triad
from calib.poses import Poses
from calib.recording import Recording
from calib.solvers import accel_solvers, gyro_solvers
from calib.statics import find_poses
from calib.turns import Turns, find_turns
from calib.types import FloatArray, IntArray
from calib.units import check_units

T = TypeVar("T")

ACCEL_METHOD = "maximum_likelihood"
GYRO_METHOD = "rotation_segment_3x3"

DISTINCT = np.radians(10.0)
"""Poses whose gravity differs by less than this are one pose: more than a table's tilt."""

UPPER = tuple(f"accel.misalignment.{pair}" for pair in ("xy", "xz", "yz"))
"""Zero by the definition of the sensor frame."""

LONGEST_GAP = 0.05
"""s; a turn with a longer gap is left out. A hand turns at up to 20 rad/s² or so: bridged by a
straight line, this gap costs 20 * 0.05³ / 12 rad, a hundredth of a degree."""


def calibrate(
    recording: Recording,
    *,
    gravity: Gravity | float,
    accel_method: str = ACCEL_METHOD,
    gyro_method: str = GYRO_METHOD,
    options: Mapping[str, object] | None = None,
    poses: Poses | None = None,
    provenance: Provenance | None = None,
) -> Calibration:
    """Calibrate a device from what it recorded at rest in several poses, and turning between them.

    Parameters
    ----------
    recording : Recording
        Of several files joined, or whole. No turn is read across a gap.
    gravity : Gravity or float, m/s²
    accel_method, gyro_method : str
        Names of solvers.
    options : mapping, optional
        What a gyroscope method needs beyond the recording, such as ``table_rate`` (rad/s).
    poses : Poses, optional
        Its static poses, if they were found already. They are found again where samples of the
        recording were read again, or are off course.
    provenance : Provenance, optional
        Its device is filled in from the recording.

    Returns
    -------
    Calibration
        With `undetermined` parameters where the recording does not tell.

    Raises
    ------
    UnitError
        If the values do not have the unit that was declared.
    InsufficientMotionError
        If the sensor was never at rest, or in one pose only.
    ValueError
        If a method is unknown, or an option that it needs is missing.
    """
    gravity = gravity if isinstance(gravity, Gravity) else Gravity(gravity, "given")
    if not EARTH[0] < gravity.value < EARTH[1]:
        raise ValueError(
            f"`gravity` must be between {EARTH[0]} and {EARTH[1]} m/s², as on Earth, got "
            f"{gravity.value:g}"
        )
    _choose(accel_solvers(), "accel_method", accel_method)
    solve_gyro = _choose(gyro_solvers(), "gyro_method", gyro_method).solve
    recording, _, again, spikes = measured(recording)
    if poses is None or again.size or spikes.size:
        poses = find_poses(recording)
    check_units(recording, poses)
    _check_poses(recording, poses, enough=1 if gyro_method == "rate_table" else 2)

    accel = _accel_fit(poses, accel_method, gravity=gravity.value)
    turns = find_turns(recording, poses)
    left_out: tuple[Exclusion, ...] = ()
    if gyro_method != "rate_table":  # which needs no whole angle, and may be told a rate for each
        turns, left_out = usable_turns(recording, turns)
    gyro = solve_gyro(
        recording, poses, turns, accel.triad, gravity=gravity.value, options=options or {}
    )
    gyro = replace(gyro, excluded=(*gyro.excluded, *left_out))

    names, covariance, undetermined = _merge(accel, gyro)
    temperature, reference = None, 25.0
    if poses.temperature is not None:
        reference = round(float(poses.temperature.mean()), 2)
        temperature = TemperatureRange(
            float(poses.temperature.min()), float(poses.temperature.max())
        )
    provenance = provenance or Provenance()
    return Calibration(
        SensorModel(accel.triad, gyro.triad, (), reference),
        names,
        covariance,
        undetermined,
        gravity,
        accel=TriadSummary.from_fit(accel),
        gyro=TriadSummary.from_fit(gyro),
        temperature=temperature,
        noise=noise_at_rest(recording, poses),
        poses=PoseTable.from_poses(poses),
        provenance=replace(provenance, device=recording.device),
    )


def noise_at_rest(recording: Recording, poses: Poses) -> Noise | None:
    """Return the white noise of each channel: the median over the poses of their variance."""
    if not len(poses) or recording.interval <= 0:
        return None
    rate = 1.0 / recording.interval
    variances = np.array(
        [
            [recording.accel[a:b].var(axis=0, ddof=1), recording.gyro[a:b].var(axis=0, ddof=1)]
            for a, b in zip(poses.start, poses.stop, strict=True)
        ]
    )
    density = np.sqrt(np.median(variances, axis=0) * 2.0 / rate)
    return Noise(rate, density[0], density[1])


def distinct_poses(accel: FloatArray) -> int:
    """Return how many of (k, 3) readings at rest are `DISTINCT` in direction."""
    directions = accel / np.linalg.norm(accel, axis=1, keepdims=True)
    kept: list[FloatArray] = []
    for direction in directions:
        if all(direction @ other < np.cos(DISTINCT) for other in kept):
            kept.append(direction)
    return len(kept)


def _choose(solvers: Mapping[str, T], label: str, name: str) -> T:
    if name not in solvers:
        raise ValueError(f"`{label}` must be one of {', '.join(solvers)}, got {name!r}")
    return solvers[name]


def _accel_fit(poses: Poses, method: str, *, gravity: float) -> Fit:
    """Solve the accelerometer; where the poses determine nothing of it, say so in the `Fit`."""
    try:
        return accel_solvers()[method].solve(poses, gravity=gravity)
    except InsufficientMotionError as error:
        names = tuple(name for name in Triad().parameters("accel") if name not in UPPER)
        p = len(names)
        return Fit(
            method=method,
            triad=Triad(),
            names=names,
            values=np.zeros(p),
            units=tuple(PARAMETER_UNITS[name.rpartition(".")[0]] for name in names),
            covariance=np.full((p, p), np.nan),
            residuals=np.zeros((0, 1)),
            residual_unit="m/s²",
            intervals=np.zeros((0, 2)),
            degrees_of_freedom=0,
            condition_number=np.inf,
            undetermined=names,
            advice=(str(error),),
        )


def _check_poses(recording: Recording, poses: Poses, *, enough: int) -> None:
    advice = (
        "lay the sensor down in ten or more different poses, at rest for 3 s in each, and turn it "
        "by 90° or more from one to the next"
    )
    if not len(poses):
        raise InsufficientMotionError(
            f"no static pose in {recording.duration:.4g} s: the sensor was never at rest for a "
            f"second; {advice}"
        )
    if distinct_poses(poses.accel) < enough:
        raise InsufficientMotionError(
            f"one pose only in {recording.duration:.4g} s: gravity never changed direction by more "
            f"than {np.degrees(DISTINCT):.0f}°, so scale factors and bias cannot be told apart; "
            f"{advice}"
        )


def usable_turns(recording: Recording, turns: Turns) -> tuple[Turns, tuple[Exclusion, ...]]:
    """Leave out turns whose angle is not in the samples: gaps too long to bridge, and clipping."""
    step = np.diff(recording.time)
    gaps = np.flatnonzero(step > max(LONGEST_GAP, 3 * recording.interval))
    clipped = _clipped(recording)
    keep = np.ones(len(turns), bool)
    left_out = []
    for k, (start, stop) in enumerate(zip(turns.start, turns.stop, strict=True)):
        missing = gaps[(gaps >= start) & (gaps < stop - 1)]
        limited = int(np.count_nonzero((clipped >= start) & (clipped < stop)))
        if len(missing):
            reason = f"samples are missing for {step[missing].max():.3g} s"
        elif limited:
            reason = f"the gyroscope is at its limit in {limited} samples"
        else:
            continue
        keep[k] = False
        low, high = turns.interval[k]
        left_out.append(Exclusion((float(low), float(high)), 0.0, reason))
    return (turns if keep.all() else turns.select(np.flatnonzero(keep))), tuple(left_out)


def _clipped(recording: Recording) -> IntArray:
    """Return the samples at which a channel of the gyroscope is at its limit."""
    resolution = faults.resolution(recording.gyro)
    noise = np.maximum(faults.noise_at_rest(recording.gyro), resolution)
    found = faults.find_limits(
        recording.gyro,
        full_scale=recording.device.gyro_full_scale,
        lsb=recording.device.gyro_lsb,
        noise=noise,
    )
    return np.unique(np.concatenate(found))


def _merge(accel: Fit, gyro: Fit) -> tuple[tuple[str, ...], FloatArray, tuple[str, ...]]:
    """Return the determined names of both fits, their covariance, and what is undetermined.

    The accelerometer's errors, through the directions of gravity, are part of the gyroscope's.
    """
    names: list[str] = []
    blocks, rows = [], []
    for fit in (accel, gyro):
        known = [k for k, name in enumerate(fit.names) if name not in fit.undetermined]
        names += [fit.names[k] for k in known]
        block = fit.covariance[np.ix_(known, known)]
        blocks.append(0.5 * (block + block.T))
        rows.append(known)
    covariance = block_diag(*blocks)
    if gyro.accel_sensitivity is not None:
        order = list(Triad().parameters("accel"))
        columns = [order.index(accel.names[k]) for k in rows[0]]
        carried = gyro.accel_sensitivity[np.ix_(rows[1], columns)]
        count = len(columns)
        across = carried @ blocks[0]
        own = across @ carried.T
        covariance[count:, :count], covariance[:count, count:] = across, across.T
        covariance[count:, count:] += 0.5 * (own + own.T)
    return tuple(names), covariance, (*accel.undetermined, *gyro.undetermined)
