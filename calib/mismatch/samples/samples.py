"""What shows in the samples themselves and not in means or closures.

Clipping, coarse rounding, repeats, stuck channels, a wrong unit, swapped axes: each is seen in the
samples by the tests of `calib.faults` and `calib.units`, whose false alarm is below 1e-6.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calib import faults
from calib.frozen import find_frozen
from calib.gated import find_gated
from calib.lsb import find_stuck_bits
from calib.mismatch.findings.diagnosis import Finding, Interval, Unexplained
from calib.mismatch.noise.hush import least_noise, silent
from calib.mismatch.samples.coarse import find_coarse
from calib.mismatch.samples.found import (
    FROZEN,
    GATED,
    RESTLESS,
    STUCK,
    STUCK_BIT,
    SWAPPED,
    WEIGHTLESS,
    WRAPPED,
    Samples,
    fault_finding,
    intervals_of,
    join_intervals,
    with_disagreement,
)
from calib.mismatch.samples.reading import after_gaps, repeated
from calib.mismatch.samples.units import look_at_units
from calib.mismatch.samples.unrest import find_unrest
from calib.ordering import find_swapped
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.repeats import find_repeats
from calib.types import BoolArray, FloatArray, IntArray
from calib.weightless import find_weightless
from calib.wrapped import find_wrapped

NOISES = 6.0
"""Noises beyond a limit that no sample of a triad has whose range that is."""


def look_at_samples(recording: Recording, poses: Poses) -> Samples:
    """Look for what is wrong with single samples, units and axes."""
    wrong, odd = look_at_units(recording, poses)
    if wrong:
        return Samples(wrong, (), np.zeros(len(recording), bool), fatal=True)
    moving = outside_rests(recording, poses.start, poses.stop)
    return with_disagreement(look_at_faults(recording, moving, whole=True), odd)


def outside_rests(part: Recording, start: IntArray, stop: IntArray, *, begin: int = 0) -> BoolArray:
    """Return where no rest is in a part that begins at sample `begin`."""
    moving = np.ones(len(part), bool)
    here = (start < begin + len(part)) & (stop > begin)
    for a, b in zip(start[here] - begin, stop[here] - begin, strict=True):
        moving[max(a, 0) : b] = False
    return moving


def look_at_faults(recording: Recording, moving: BoolArray, *, whole: bool) -> Samples:
    """Look for what is wrong with single samples.

    Parameters
    ----------
    recording : Recording
    moving : (n,) array of bool
        Where no rest is.
    whole : bool
        Whether there is no more of it. In a part without motion a coarse channel may well be
        constant: that it is stuck can then not be told.
    """
    values, n = faults.values_of(recording), len(recording)
    step = faults.resolution(values)
    clipped, findings = _clipping(recording, values, step)
    # Without noise, samples are alike because nothing happens: at rest, or beside a turn about one
    # axis of a table.
    still = bool(silent(values, recording.interval).all())
    if still:
        change = np.abs(np.diff(values, axis=0, prepend=values[:1]))
        moving = moving & (change > least_noise(recording.interval)).any(axis=1)
    gated = [] if still else find_gated(values, moving)
    if gated:
        # What is stuck, or off course, is so by that.
        said = _there(recording.time, [(0, n)], tuple(CHANNELS[c] for c in gated), GATED)
        return Samples(tuple(findings), tuple(said), np.zeros(n, bool), True, n, n)
    told = n if whole or moving.any() else 0
    stuck = faults.find_stuck(values, moving, interval=recording.interval, clipped=clipped)
    if not told or (still and (np.ptp(values[:, 3:], axis=0) == 0.0).sum() >= 2):
        stuck = [run for run in stuck if run[2] - run[1] < n]
    repeats = np.zeros(0, np.int64) if still else find_repeats(values, moving)
    again = np.zeros(n, bool)
    again[repeats] = True
    known = again | _marked(n, stuck)
    frozen = find_frozen(values, moving, clipped=clipped, known=known)
    known = again | clipped.any(axis=1)
    swapped = [] if still else [(a, b) for a, b in find_swapped(values) if not known[a:b].any()]
    restless = [] if still else find_unrest(values, recording.interval)
    light = [] if stuck else find_weightless(values[:, :3], recording.interval)
    bits = [] if still else find_stuck_bits(values, step)
    wrapped = find_wrapped(values, recording.time, recording.interval)
    if repeats.size:
        findings.append(repeated(recording, repeats))
    findings += find_coarse(recording, values, moving, step)
    # What is disturbed all along is told beside a truth as it is.
    brief = [run for run in restless if run[2] - run[1] < n / 2]
    spoilt = known | after_gaps(recording)
    packets = [(0, start, stop) for start, stop in (*swapped, *light)]
    spoilt |= _marked(n, [*stuck, *frozen, *brief, *packets, *wrapped])
    count = sum(stop - start for _, start, stop in stuck)
    # A bit that is less than the noise is filled in by it.
    if any(size > faults.noise_at_rest(values)[c] for c, size in bits):
        count = n
    return Samples(
        findings=tuple(findings),
        unexplained=(
            *_runs_of(recording.time, [*stuck, *frozen], FROZEN),
            *_runs_of(recording.time, wrapped, WRAPPED),
            *_there(recording.time, swapped, CHANNELS, SWAPPED),
            *_there(recording.time, light, CHANNELS[:3], WEIGHTLESS),
            *_runs_of(recording.time, restless, RESTLESS),
            *_runs_of(recording.time, [(c, 0, n) for c in sorted({c for c, _ in bits})], STUCK_BIT),
        ),
        spoilt=spoilt,
        fatal=count > STUCK * n,
        stuck=count,
        told=told,
        restless=max((stop - start for _, start, stop in restless), default=0),
    )


def _there(
    time: FloatArray, parts: list[tuple[int, int]], channels: tuple[str, ...], follows: str
) -> list[Unexplained]:
    """Return what is said of channels in samples ``(start, stop)``, if there are any."""
    found = [(float(time[a]), float(time[b - 1])) for a, b in parts]
    if not found:
        return []
    return [Unexplained(channels, join_intervals(found), follows, faults.FALSE_ALARM)]


def _marked(n: int, runs: Iterable[tuple[int, int, int]]) -> BoolArray:
    """Return where so many samples are within a run ``(channel, start, stop)`` of any channel."""
    out = np.zeros(n, bool)
    for _, start, stop in runs:
        out[start:stop] = True
    return out


def _clipping(
    recording: Recording, values: FloatArray, step: FloatArray
) -> tuple[BoolArray, list[Finding]]:
    """Return which samples (n, 6) are at the limit of their channel, and what is said of them."""
    clipped = np.zeros(values.shape, bool)
    findings: list[Finding] = []
    if len(values) < faults.BLOCK:
        return clipped, findings
    noise = np.maximum(faults.noise_at_rest(values), step)
    found = faults.limits_of(recording, noise)
    for first, triad in ((0, "accel"), (3, "gyro")):
        limit, own = 0.0, slice(first, first + 3)
        for c, at in enumerate(found[own], first):
            if at.size:
                clipped[at, c] = True
                limit = max(limit, float(np.abs(values[at, c]).max()))
        if limit:
            size = np.abs(values[:, own])
            if not (size > limit + 1.5 * step[own] + NOISES * noise[own]).any():
                # The range is one: what another axis reached for a sample or two was cut there too.
                clipped[:, own] |= size >= limit - 1.5 * step[own]
            findings.append(_saturation(recording, clipped, triad, limit))
    return clipped, findings


def _runs_of(
    time: FloatArray, stretches: list[tuple[int, int, int]], follows: str
) -> list[Unexplained]:
    """Return what is said of stretches ``(channel, start, stop)`` of samples.

    One item for each channel, and one for channels that have the same moments.
    """
    own: dict[int, list[Interval]] = {}
    for c, start, stop in stretches:
        own.setdefault(c, []).append((float(time[start]), float(time[stop - 1])))
    places = {c: join_intervals(intervals) for c, intervals in own.items()}
    alike = {
        where: tuple(CHANNELS[c] for c in sorted(places) if places[c] == where)
        for where in places.values()
    }
    return [
        Unexplained(names, where, follows, faults.FALSE_ALARM) for where, names in alike.items()
    ]


def _saturation(recording: Recording, clipped: BoolArray, triad: str, limit: float) -> Finding:
    first = 0 if triad == "accel" else 3
    own = clipped[:, first : first + 3]
    channels = tuple(CHANNELS[first + i] for i in range(3) if own[:, i].any())
    values = {triad: 1.0, f"{triad}_full_scale": limit}
    where = intervals_of(recording.time, np.flatnonzero(own.any(axis=1)))
    return fault_finding("saturation", recording, channels, values, intervals=where)
