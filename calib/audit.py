"""What is in a recording, and what is wrong with it, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib import faults
from calib.frozen import find_frozen
from calib.gated import find_gated
from calib.gravity import STANDARD_GRAVITY as G
from calib.lsb import find_stuck_bits
from calib.measured import spikes_of
from calib.poses import Poses
from calib.recording import CHANNELS, Clock, Recording
from calib.repeats import find_repeats
from calib.statics import find_poses
from calib.tilts import Closure
from calib.timing import evened
from calib.types import BoolArray, FloatArray
from calib.units import check_units, unit_faults
from calib.wrapped import find_wrapped

__all__ = ["Audit", "Finding", "audit", "check_units"]

JITTER = 0.05
"""Of an interval, rms: from here on single steps are visibly uneven."""
RATE_ERROR = 0.10
"""Sensors' own oscillators are within 5 % of their nominal rate."""
DISTINCT = np.radians(15)
"""Poses whose gravity differs by less count as one."""
CALIBRATED_ACCEL = 1e-3
"""Of g, rms of |a| over distinct poses; raw consumer and industrial parts are above."""
CALIBRATED_GYRO = np.radians(0.1)
"""rad/s at rest; the same."""
HEATING = 10.0
"""K within a second: no chamber, and no chip, does that."""
UNITS = {"accel": "m/s²", "gyro": "rad/s"}
DISAGREE = np.radians(30)


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    ``times`` are recording seconds of the first few places, ``count`` is how many there are.
    """

    kind: str
    message: str
    channels: tuple[str, ...] = ()
    count: int = 1
    times: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Audit:
    """What a recording holds. Times in s, rates in Hz, angles in rad, temperatures in °C.

    ``static`` is the share of samples in poses, ``jitter`` the rms deviation of the steps in time.
    """

    samples: int
    duration: float
    clock: Clock
    rate: float
    jitter: float
    lost: int
    poses: Poses
    distinct_poses: int
    static: float
    rest_norm: float | None
    rest_rate: FloatArray | None
    temperature: tuple[float, float] | None
    complete: bool
    findings: tuple[Finding, ...]
    remarks: tuple[str, ...]


def audit(recording: Recording, poses: Poses | None = None) -> Audit:
    """Describe a recording and find its faults.

    Parameters
    ----------
    recording : Recording
    poses : Poses, optional
        Its static poses, if they were found already.
    """
    poses = find_poses(recording) if poses is None else poses
    at_rest = np.zeros(len(recording), bool)
    for start, stop in zip(poses.start, poses.stop, strict=True):
        at_rest[start:stop] = True
    # A stamp that is late leaves a hole before it, but no sample is missing there.
    gaps = faults.find_gaps(evened(recording))
    distinct = _distinct(poses)
    closure = Closure.of(recording, poses)
    samples = _samples(recording, at_rest)
    dead = any(found.kind == "stuck" and found.count == len(recording) for found in samples)
    findings = [
        *_timing(recording, gaps),
        *samples,
        *(
            Finding("unit", fault.message, (fault.triad,))
            for fault in unit_faults(recording, poses, closure)
        ),
        *([] if dead else _axes(closure)),
        *_calibrated(poses, distinct),
    ]
    if not recording.complete:
        note = recording.notes.get("cut", "its writer marked no clean end")
        findings.append(Finding("cut", f"the recording was cut: {note}"))
    heat = recording.temperature
    return Audit(
        samples=len(recording),
        duration=recording.duration,
        clock=recording.clock,
        rate=1 / recording.interval if recording.interval else 0.0,
        jitter=faults.jitter(recording),
        lost=int(gaps.missing.sum()),
        poses=poses,
        distinct_poses=len(distinct),
        static=float(at_rest.mean()),
        rest_norm=float(np.median(np.linalg.norm(poses.accel, axis=1))) if len(poses) else None,
        rest_rate=np.median(poses.gyro, axis=0) if len(poses) else None,
        temperature=None if heat is None else (float(heat.min()), float(heat.max())),
        complete=recording.complete,
        findings=tuple(findings),
        remarks=tuple(_remarks(recording, poses, distinct)),
    )


def _timing(recording: Recording, gaps: faults.Gaps) -> list[Finding]:
    out = []
    time, interval = recording.time, recording.interval
    if gaps.at.size:
        silent = int(gaps.missing[~gaps.declared].sum())
        out.append(
            Finding(
                "gaps",
                f"{_many(int(gaps.missing.sum()))} missing in {_many(gaps.at.size, 'gap')}, the "
                f"longest of {int(gaps.missing.max())}"
                + (f"; {silent} of them were not counted by the logger" if silent else ""),
                count=int(gaps.missing.sum()),
                times=_first(time[gaps.at]),
            )
        )
    jitter = faults.jitter(recording)
    if interval and jitter > JITTER * interval:
        out.append(
            Finding(
                "jitter",
                f"steps in time scatter by {1e3 * jitter:.3g} ms about {1e3 * interval:.4g} ms "
                f"({jitter / interval:.0%})",
            )
        )
    if recording.clock == "invalid":
        out.append(
            Finding(
                "clock",
                "the clock is known to be wrong: the order of the samples is real, their "
                "time is not",
            )
        )
    elif (heating := _heating(recording)) > HEATING:
        out.append(
            Finding(
                "clock",
                f"the temperature changes by {heating:.0f} K within a second, which nothing does: "
                "the clock must be wrong",
            )
        )
    nominal = recording.device.rate
    if nominal and interval and abs(1 / (interval * nominal) - 1) > RATE_ERROR:
        out.append(
            Finding(
                "rate",
                f"stamps are {1 / interval:.5g} Hz apart, the device is set to {nominal:.5g} Hz: "
                "the unit of time, or the clock, is wrong",
            )
        )
    return out


def _heating(recording: Recording) -> float:
    """Return the largest change of temperature within a second, of means over 32 samples."""
    heat, width = recording.temperature, 32
    if heat is None or len(recording) < 3 * width:
        return 0.0
    count = len(heat) // width
    mean = np.median(heat[: count * width].reshape(count, width), axis=1)
    time = recording.time[: count * width].reshape(count, width).mean(axis=1)
    later = np.minimum(np.searchsorted(time, time + 1.0, side="right") - 1, count - 1)
    later = np.maximum(later, np.minimum(np.arange(count) + 1, count - 1))
    span = np.maximum(time[later] - time, 1.0)
    return float((np.abs(mean[later] - mean) / span).max())


def _samples(recording: Recording, at_rest: BoolArray) -> list[Finding]:
    values = faults.values_of(recording)
    n, time = len(values), recording.time
    step, noise = faults.resolution(values), faults.noise_at_rest(values)
    out = []
    clipped = np.zeros((n, 6), bool)
    limits = faults.limits_of(recording, np.maximum(noise, step))
    for c, (name, at) in enumerate(zip(CHANNELS, limits, strict=True)):
        triad = name.split(".")[0]
        if at.size and n >= faults.BLOCK:
            clipped[at, c] = True
            limit = float(np.abs(values[at, c]).max())
            out.append(
                Finding(
                    "clipping",
                    f"{name} is at its limit ({limit:.4g} {UNITS[triad]}) in {_many(at.size)}",
                    (name,),
                    int(at.size),
                    _first(time[at]),
                )
            )
    stuck = faults.find_stuck(values, ~at_rest, interval=recording.interval, clipped=clipped)
    repeats = find_repeats(values, ~at_rest)
    known = np.zeros(n, bool)
    known[repeats] = True
    for _, start, stop in stuck:
        known[start:stop] = True
    stuck += find_frozen(values, ~at_rest, clipped=clipped, known=known)
    for c, start, stop in stuck:
        span = (
            "throughout"
            if stop - start == n
            else f"from {time[start]:.2f} to {time[stop - 1]:.2f} s"
        )
        out.append(
            Finding(
                "stuck",
                f"{CHANNELS[c]} does not change {span} ({values[start, c]:.5g})",
                (CHANNELS[c],),
                stop - start,
                (float(time[start]),),
            )
        )
    for c, start, stop in find_wrapped(values, time, recording.interval):
        message = f"{CHANNELS[c]} wraps around at the end of its range in {_many(stop - start)}"
        out.append(Finding("wrapped", message, (CHANNELS[c],), stop - start, (float(time[start]),)))
    for c in find_gated(values, ~at_rest):
        message = f"{CHANNELS[c]} is set to one value at rest: a dead band, or a zero-rate update"
        out.append(Finding("gated", message, (CHANNELS[c],), n))
    for c, size in find_stuck_bits(values, step):
        unit = UNITS[CHANNELS[c].split(".")[0]]
        message = f"a bit of {CHANNELS[c]}, of {size:.3g} {unit}, never changes"
        out.append(Finding("bit", message, (CHANNELS[c],), n))
    for c, d, where in faults.find_copies(values):
        both, at = (CHANNELS[c], CHANNELS[d]), np.flatnonzero(where)
        span = "throughout" if len(at) == n else f"in {_many(at.size)}"
        message = f"{both[0]} and {both[1]} are the same {span}: a register may be read twice"
        out.append(Finding("copied", message, both, int(at.size), _first(time[at])))
    if repeats.size:
        out.append(
            Finding(
                "repeats",
                f"{_many(repeats.size)} ({repeats.size / n:.2%}) the same as ones just before in "
                "all channels",
                count=int(repeats.size),
                times=_first(time[repeats]),
            )
        )
    spikes = spikes_of(recording).tolist()
    if spikes:
        names = tuple(dict.fromkeys(CHANNELS[c] for *_, c in spikes))
        out.append(
            Finding(
                "spikes",
                f"{_many(len(spikes), 'spike')}: samples that are off course, and back at once "
                f"({', '.join(names)}); calibrate, verify and diagnose bridge them",
                names,
                len(spikes),
                _first(time[[k for k, *_ in spikes]]),
            )
        )
    return out


def _axes(closure: Closure | None) -> list[Finding]:
    if closure is None or len(closure) < 3 or closure.factor != 1.0:
        return []
    if closure.missed < DISAGREE + closure.lean:
        return []
    miss = f"gravity and the gyroscope disagree by {np.degrees(closure.missed):.0f}° over a turn"
    if np.array_equal(closure.axes, np.eye(3)):
        why = "; no unit and no order of axes explains it"
    else:
        names = ("xyz"[int(np.argmax(np.abs(row)))] for row in closure.axes)
        signs = ("-" if row.sum() < 0 else "" for row in closure.axes)
        order = ", ".join(sign + name for sign, name in zip(signs, names, strict=True))
        why = f", unless the gyroscope's x, y, z are its ({order})"
    return [Finding("axes", miss + why, ("gyro",), len(closure))]


def _calibrated(poses: Poses, distinct: list[int]) -> list[Finding]:
    if len(distinct) < 6:
        return []
    accel = poses.accel[distinct]
    norm = np.linalg.norm(accel, axis=1)
    unit = accel / norm[:, None]
    if np.linalg.eigvalsh(unit.T @ unit / len(unit))[0] < 0.1:
        return []
    error = np.sqrt(np.mean((norm / G - 1) ** 2))
    rest = np.linalg.norm(np.median(poses.gyro, axis=0))
    if error > CALIBRATED_ACCEL or rest > CALIBRATED_GYRO:
        return []
    return [
        Finding(
            "calibrated",
            f"looks already calibrated: |a| is g within {error:.2%} in {len(distinct)} poses, and "
            f"the gyroscope reads {np.degrees(rest):.2g}°/s at rest",
        )
    ]


def _distinct(poses: Poses) -> list[int]:
    """Return one pose for each direction of gravity."""
    if not len(poses):
        return []
    unit = poses.accel / np.linalg.norm(poses.accel, axis=1, keepdims=True)
    kept: list[int] = []
    for k in range(len(unit)):
        if not kept or (unit[kept] @ unit[k]).max() < np.cos(DISTINCT):
            kept.append(k)
    return kept


def _remarks(recording: Recording, poses: Poses, distinct: list[int]) -> list[str]:
    out = []
    if not len(poses):
        out.append("the sensor never rests: nothing can be calibrated from gravity")
    elif len(distinct) < 9:
        out.append(
            f"{_many(len(distinct), 'distinct pose')}: a full accelerometer calibration takes 9 or "
            "more, well spread"
        )
    if recording.clock == "nominal":
        out.append("time is the sample number over the nominal rate: a wrong rate would not show")
    return out


def _many(count: int, noun: str = "sample") -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _first(times: FloatArray) -> tuple[float, ...]:
    return tuple(float(t) for t in times[:10])
