"""What shows in the samples themselves and not in means or closures.

Clipping, coarse rounding, repeats, stuck channels, a wrong unit, swapped axes: each is seen in the
samples by the tests of `calib.faults` and `calib.units`, whose false alarm is below 1e-6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib import faults
from calib.calibration import Quantity, parameter_unit
from calib.effects import get_effect
from calib.effects.axis_error import ORDERS, signed_permutation
from calib.frozen import find_frozen
from calib.measured import Measured
from calib.mismatch.findings.diagnosis import Finding, Interval, Unexplained
from calib.mismatch.findings.heldout import HeldOut
from calib.mismatch.noise.hush import least_noise, silent
from calib.mismatch.samples.losses import Loss
from calib.mismatch.samples.within import SEVERAL, densest
from calib.ordering import find_swapped
from calib.poses import Poses
from calib.recording import CHANNELS, Recording
from calib.repeats import find_repeats
from calib.synchrony import STEP, gyro_delay
from calib.tilts import FEWEST, GYRO_FACTORS, Closure
from calib.turns import find_turns
from calib.types import BoolArray, FloatArray, IntArray
from calib.units import ACCEL_FACTORS, name_of, unit_faults

_JOIN = 1.0
"""Places closer than this are one interval, s."""

PLACES = 50
"""Intervals that are told apart, at most."""

_COARSE = 0.5
"""A count larger than the noise over this: rounding is no longer hidden by noise."""

GAP = 2.5
"""Sample intervals without a sample, from which on a turn is not integrated across them."""

CERTAIN = 0.1
"""Standard error of a number of samples below which it is no other: one in a hundred is off."""

MANY = 100_000
"""Samples that are looked at for whether they step in counts."""

GYRO = CHANNELS[3:]

BEYOND = "nothing: no gyroscope reads that at rest"

PUSHED, HARDEST = "motion: nothing that rests in between is pushed so hard", 1e3
"""What is unexplained where most turns reach such a specific force, m/s²: a hand does 5 g, a knock
at the bench 50 g for a sample or two, and few accelerometers measure 100 g."""

DISAGREES = "turns: by the gyroscope they are others than by the accelerometer"
"""What is unexplained where neither a unit nor an order of axes explains most turns."""

COPIED = "nothing: one repeats the other"

NEEDED = {
    DISAGREES: "a gyroscope and an accelerometer that agree on the turns",
    BEYOND: "a gyroscope that reads less at rest",
    PUSHED: "an accelerometer that reads what moves it: a cable or a register gives something else",
    COPIED: "channels of their own: a register may be read twice",
}
"""What a recording lacks that ends with its samples, by what they are off by."""

SPIKES = "nothing: samples are off course, and back at once"

DOWNWARDS = ORDERS.index(((0, 1, 2), (-1, -1, -1)))
"""How axes lie of which all have the wrong sign."""

FROZEN = "nothing: it is stuck"

SWAPPED = "nothing: samples are not in the order they were taken in"

STUCK = 0.2
"""Share of the recording for which a channel that is stuck leaves nothing to compare with."""


class Samples(NamedTuple):
    """What the samples show. ``fatal`` means that nothing else can be said until it is mended.

    ``spoilt`` marks samples that no model of the sensor can explain: a turn with one is not closed.
    ``stuck`` counts the samples at which a channel is stuck, of ``told`` where that can be seen.
    """

    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    spoilt: BoolArray
    fatal: bool
    stuck: int = 0
    told: int = 0

    @property
    def need(self) -> str:
        """What must be mended first where they are fatal."""
        need = "right units and axes"
        if any(f.effect == "time_offset" for f in self.findings):
            need = "a gyroscope and an accelerometer on one clock"
        if self.unexplained:
            need = NEEDED.get(self.unexplained[-1].follows, "channels that move: one is stuck")
        return f"{need}: mend that and diagnose again"


def look_at_samples(recording: Recording, poses: Poses) -> Samples:
    """Look for what is wrong with single samples, units and axes."""
    wrong, odd = look_at_units(recording, poses)
    if wrong:
        return Samples(wrong, (), np.zeros(len(recording), bool), fatal=True)
    moving = outside_rests(recording, poses.start, poses.stop)
    return with_disagreement(look_at_faults(recording, moving, whole=True), odd)


def with_disagreement(seen: Samples, odd: tuple[Unexplained, ...]) -> Samples:
    """Return what the samples show with turns that disagree, if nothing seen in them does it."""
    known = {f.effect for f in seen.findings} & {"saturation", "dropped_samples"}
    if not odd or seen.unexplained or (known and odd[0].follows == DISAGREES):
        return seen
    return seen._replace(unexplained=odd, fatal=True)


def outside_rests(part: Recording, start: IntArray, stop: IntArray, *, begin: int = 0) -> BoolArray:
    """Return where no rest is in a part that begins at sample `begin`."""
    moving = np.ones(len(part), bool)
    here = (start < begin + len(part)) & (stop > begin)
    for a, b in zip(start[here] - begin, stop[here] - begin, strict=True):
        moving[max(a, 0) : b] = False
    return moving


def look_at_units(
    recording: Recording, poses: Poses
) -> tuple[tuple[Finding, ...], tuple[Unexplained, ...]]:
    """Look for wrong units and axes; and for turns that no unit and no axes make agree.

    A channel that repeats another one, or is dead, makes both look wrong.
    """
    values = faults.values_of(recording)
    for c, d, same in faults.find_copies(values):
        if same.sum() > STUCK * len(recording):
            places = intervals_of(recording.time, np.flatnonzero(same))
            names = CHANNELS[c], CHANNELS[d]
            return (), (Unexplained(names, places, COPIED, faults.FALSE_ALARM),)
    dead = np.ptp(values[:, :3], axis=0) == 0.0
    if dead.any() and not dead.all() and len(recording) >= faults.BLOCK:
        return (), ()
    closure = Closure.of(recording, poses) if len(poses) else None
    late = gyro_delay(recording)
    if late is not None:
        # Turns that are compared with others than themselves tell nothing of units and axes.
        found = {"gyro_delay": late}
        return (_finding("time_offset", recording, GYRO, found, spread={"gyro_delay": STEP}),), ()
    wrong = (*_units(recording, poses, closure), *_axes(recording, closure))
    if wrong or not len(poses):
        return wrong, ()
    far = np.abs(np.median(poses.gyro, axis=0)) > faults.FASTEST
    if far.any():
        axes = tuple(f"gyro.{a}" for a, off in zip("xyz", far, strict=True) if off)
        whole = (float(recording.time[0]), float(recording.time[-1]))
        return (), (Unexplained(axes, (whole,), BEYOND, faults.FALSE_ALARM),)
    turns = find_turns(recording, poses)
    spans = zip(turns.start.tolist(), turns.stop.tolist(), strict=True)
    force = np.array([np.abs(recording.accel[a:b]).max(axis=0) for a, b in spans])
    hard = np.median(force, axis=0) > HARDEST if len(force) else np.zeros(3, bool)
    if hard.any():
        axes = tuple(CHANNELS[c] for c in np.flatnonzero(hard))
        moved = float(poses.interval[0, 1]), float(poses.interval[-1, 0])
        return (), (Unexplained(axes, (moved,), PUSHED, faults.FALSE_ALARM),)
    if closure is None or len(closure) < FEWEST or closure.agrees:
        return (), ()
    where = _join_intervals([(float(a), float(b)) for a, b in closure.disagreeing])
    return (), (Unexplained(CHANNELS, where, DISAGREES, faults.FALSE_ALARM),)


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
    spoilt = np.zeros(len(recording), bool)
    values = faults.values_of(recording)
    findings: list[Finding] = []
    clipped = np.zeros(values.shape, bool)
    step, noise = faults.resolution(values), faults.noise_at_rest(values)
    for first, triad in ((0, "accel"), (3, "gyro")):
        limit = 0.0
        for c in range(first, first + 3):
            at = faults.find_clipping(
                values[:, c],
                full_scale=getattr(recording.device, f"{triad}_full_scale"),
                lsb=getattr(recording.device, f"{triad}_lsb"),
                noise=float(max(noise[c], step[c])),
            )
            if at.size and len(values) >= faults.BLOCK:
                clipped[at, c] = True
                limit = max(limit, float(np.abs(values[at, c]).max()))
        if limit:
            # The range is one: what another axis reached for a sample or two was cut there as well.
            own = slice(first, first + 3)
            clipped[:, own] |= np.abs(values[:, own]) >= limit - 1.5 * step[own]
            findings.append(_saturation(recording, clipped, triad, limit))
    # Without noise, samples are alike because nothing happens: at rest, or beside a turn about one
    # axis of a table.
    still = silent(values, recording.interval).all()
    table = still and (np.ptp(values[:, 3:], axis=0) == 0.0).sum() >= 2
    if still:
        change = np.abs(np.diff(values, axis=0, prepend=values[:1]))
        moving = moving & (change > least_noise(recording.interval)).any(axis=1)
    stretches: list[tuple[int, int, int]] = []
    stuck = 0
    told = len(recording) if whole or moving.any() else 0
    for c, start, stop in faults.find_stuck(
        values, moving, interval=recording.interval, clipped=clipped
    ):
        if (table or not told) and stop - start == len(recording):
            continue
        stretches.append((c, start, stop))
        spoilt[start:stop] = True
        stuck += stop - start
    repeats = np.zeros(0, np.int64) if still else find_repeats(values, moving)
    known = spoilt.copy()
    known[repeats] = True
    for c, start, stop in find_frozen(values, moving, clipped=clipped, known=known):
        stretches.append((c, start, stop))
        spoilt[start:stop] = True
    unexplained = _stuck(recording.time, stretches)
    known[:] = clipped.any(axis=1)
    known[repeats] = True
    swapped = [] if still else [(a, b) for a, b in find_swapped(values) if not known[a:b].any()]
    for start, stop in swapped:
        spoilt[start:stop] = True
    if swapped:
        found = [(float(recording.time[a]), float(recording.time[b - 1])) for a, b in swapped]
        where = _join_intervals(found)
        unexplained.append(Unexplained(CHANNELS, where, SWAPPED, faults.FALSE_ALARM))
    if repeats.size:
        findings.append(_repeats(recording, repeats))
    findings += _coarse(recording, values, moving, step)
    spoilt |= clipped.any(axis=1) | after_gaps(recording)
    spoilt[repeats] = True
    fatal = stuck > STUCK * len(recording)
    return Samples(tuple(findings), tuple(unexplained), spoilt, fatal, stuck, told)


def after_gaps(recording: Recording) -> BoolArray:
    """Return which samples some are missing before: the source counted them, or time did, (n,)."""
    assert recording.lost is not None
    out = np.asarray(recording.lost > 0)
    out[1:] |= np.diff(recording.time) > GAP * recording.interval
    return out


def _stuck(time: FloatArray, stretches: list[tuple[int, int, int]]) -> list[Unexplained]:
    """Return what is said of stretches ``(channel, start, stop)`` of samples that are stuck.

    One item for each channel, and one for channels that are stuck at the same moments.
    """
    own: dict[int, list[Interval]] = {}
    for c, start, stop in stretches:
        own.setdefault(c, []).append((float(time[start]), float(time[stop - 1])))
    places = {c: _join_intervals(intervals) for c, intervals in own.items()}
    alike = {
        where: tuple(CHANNELS[c] for c in sorted(places) if places[c] == where)
        for where in places.values()
    }
    return [Unexplained(names, where, FROZEN, faults.FALSE_ALARM) for where, names in alike.items()]


def join_samples(parts: Sequence[Samples]) -> Samples:
    """Return what was seen in the parts of one recording, without ``spoilt``, as one.

    Each part was a look of its own, which the p-values count.
    """
    kinds: dict[tuple[str, str], list[Finding]] = {}
    odd: dict[tuple[tuple[str, ...], str], list[Interval]] = {}
    for part in parts:
        for item in part.findings:
            kinds.setdefault((item.effect, next(iter(item.parameters))), []).append(item)
        for left in part.unexplained:
            odd.setdefault((left.channels, left.follows), []).extend(left.intervals)
    chance = min(1.0, faults.FALSE_ALARM * len(parts))
    findings = []
    for items in kinds.values():
        values = {name: [item.parameters[name] for item in items] for name in items[0].parameters}
        findings.append(
            replace(
                items[0],
                channels=tuple(c for c in CHANNELS if any(c in item.channels for item in items)),
                intervals=_join_intervals([i for item in items for i in item.intervals]),
                parameters={name: _common(name, found) for name, found in values.items()},
                p_value=chance,
            )
        )
    unexplained = [
        Unexplained(names, (where,), follows, chance)
        for (names, follows), intervals in odd.items()
        for where in _join_intervals(intervals)
    ]
    stuck, told = sum(part.stuck for part in parts), sum(part.told for part in parts)
    none = np.zeros(0, bool)
    return Samples(tuple(findings), tuple(unexplained), none, stuck > STUCK * told, stuck, told)


def _common(name: str, found: list[Quantity]) -> Quantity:
    """Return what one parameter of a fault is over several parts of a recording."""
    values = [q.value for q in found]
    value = sum(values) if name == "count" else min(values) if name == "moment" else max(values)
    return replace(found[0], value=value)


def _join_intervals(found: list[Interval]) -> tuple[Interval, ...]:
    """Return intervals in their order, those joined that meet; at most `PLACES`."""
    first, last = np.array(sorted(found)).T
    return _cut(first, last, first[1:] - last[:-1])


def _units(recording: Recording, poses: Poses, closure: Closure | None) -> list[Finding]:
    out = []
    for fault in unit_faults(recording, poses, closure):
        own = "" if fault.channel is None else f".{'xyz'[fault.channel]}"
        channels = tuple(c for c in CHANNELS if c.startswith(fault.triad + own))
        values = {fault.triad: fault.factor - 1.0}
        where = () if fault.interval is None else (fault.interval,)
        out.append(_finding("unit_error", recording, channels, values, fault.message, where))
    return out


def _axes(recording: Recording, closure: Closure | None) -> list[Finding]:
    if closure is None or np.array_equal(closure.axes, np.eye(3)):
        return []
    # The closure knows what undoes the mistake; the effect states the mistake.
    made = closure.axes.T
    number = next((k for k in range(len(ORDERS)) if np.array_equal(signed_permutation(k), made)), 0)
    names = tuple(f"gyro.{a}" for a, row in zip("xyz", made - np.eye(3), strict=True) if row.any())
    return [_finding("axis_error", recording, names, {"gyro": 1.0, "gyro_axes": float(number)})]


def axes_beside(
    recording: Recording, numbers: Mapping[str, int], *, other: str = "simulation"
) -> Finding:
    """Return the finding that triads show the axes of the `other` in another order."""
    values: dict[str, float] = {}
    names: list[str] = []
    for triad, number in numbers.items():
        values |= {triad: 1.0, f"{triad}_axes": float(number)}
        off = signed_permutation(number) - np.eye(3)
        names += [f"{triad}.{a}" for a, row in zip("xyz", off, strict=True) if row.any()]
    whose = f"The two do not have the same axes: mend those of the recording, or of the {other}."
    found = _finding("axis_error", recording, tuple(names), values)
    words = get_effect("axis_error").in_words(values)
    if numbers.get("accel") == DOWNWARDS:
        words += " An accelerometer at rest reads 1 g upwards, and not downwards."
    return replace(found, sentence=f"{whose} Beside the {other}: {words}")


def factor_beside(recording: Recording, triad: str, factor: float, *, other: str) -> Finding:
    """Return the finding that a triad reads so many times what the `other` has."""
    channels, known = (CHANNELS[:3], ACCEL_FACTORS) if triad == "accel" else (GYRO, GYRO_FACTORS)
    found = _finding("unit_error", recording, channels, {triad: factor - 1.0})
    return replace(
        found,
        sentence=f"The {triad} reads {factor:.4g} times what the {other} has: check the units and "
        f"ranges of both{name_of(factor, known)}.",
    )


def _saturation(recording: Recording, clipped: BoolArray, triad: str, limit: float) -> Finding:
    first = 0 if triad == "accel" else 3
    own = clipped[:, first : first + 3]
    channels = tuple(CHANNELS[first + i] for i in range(3) if own[:, i].any())
    values = {triad: 1.0, f"{triad}_full_scale": limit}
    where = intervals_of(recording.time, np.flatnonzero(own.any(axis=1)))
    return _finding("saturation", recording, channels, values, intervals=where)


def read_again(recording: Recording, again: IntArray) -> Samples:
    """Return what a recording shows of which samples were read again throughout."""
    if not again.size:
        return Samples((), (), np.zeros(0, bool), fatal=False)
    share = again.size / len(recording)
    found = replace(
        _repeats(recording, again),
        regime="time: throughout",
        sentence=f"The sensor was read faster than it measures: {share:.0%} of the samples are the "
        "one before, read again. They are left out of all that follows.",
    )
    return Samples((found,), (), np.zeros(0, bool), fatal=False)


def with_reading(seen: Samples, recording: Recording, read: Measured) -> Samples:
    """Return what the samples of a recording show, and what reading it had made of them."""
    return seen._replace(
        findings=(*read_again(recording, read.again).findings, *seen.findings),
        unexplained=(*off_course(read.recording, read.spikes), *seen.unexplained),
    )


def off_course(recording: Recording, spikes: IntArray) -> tuple[Unexplained, ...]:
    """Return what spikes (k, 3), as `Measured` has them, say of each channel.

    Each is at its moment; several are where they are dense.
    """
    out = []
    time = recording.time
    for c in np.unique(spikes[:, 2]).tolist():
        own = spikes[spikes[:, 2] == c]
        if len(own) < SEVERAL:
            samples = [np.arange(start, stop) for start, stop, _ in own.tolist()]
            where = intervals_of(time, np.concatenate(samples))
        else:
            where = (densest(time[own[:, 0]], (float(time[0]), float(time[-1]))),)
        out.append(Unexplained((CHANNELS[c],), where, SPIKES, faults.FALSE_ALARM))
    return tuple(out)


def _repeats(recording: Recording, repeats: IntArray) -> Finding:
    values = {"count": -float(repeats.size), "moment": float(recording.time[repeats[0]])}
    where = intervals_of(recording.time, repeats)
    return _finding("dropped_samples", recording, CHANNELS, values, intervals=where)


def lost_samples(recording: Recording, loss: Loss, turn: FloatArray) -> Finding:
    """Return the finding of a loss that the closure of its own turn shows."""
    late, number = loss.spread
    spread = {"moment": float(np.hypot(recording.interval, late))}
    if number > CERTAIN:
        spread["count"] = number
    found = _finding(
        "dropped_samples",
        recording,
        CHANNELS,
        {"count": float(loss.number), "moment": loss.moment},
        intervals=((float(turn[0]), float(turn[1])),),
        spread=spread,
    )
    # Two of the turn's five equations find where and how many; the others prove it.
    gain = 2.5 * (loss.before**2 - loss.after**2)
    proof = HeldOut(
        loss.before, loss.after, 1.0, "1", "closure of this turn, in scatters of all turns", gain
    )
    return replace(found, held_out=proof, held_out_reason="")


def _coarse(
    recording: Recording, values: FloatArray, moving: BoolArray, step: FloatArray
) -> list[Finding]:
    """Rounding is coarse where most neighbours at rest are equal, and the others a count apart."""
    rest = np.flatnonzero(~moving)
    inside = np.diff(rest) == 1
    if not inside.any():
        return []
    change = np.abs(np.diff(values[rest], axis=0))[inside]
    # Without noise nothing changes at rest: there the counts show in motion alone.
    moved = np.abs(np.diff(values[:MANY], axis=0))
    # Finer than any part rounds are the decimals of a file without noise.
    finest = {s.name.split("_")[0]: s.low or 0.0 for s in get_effect("quantization").shape}
    out = []
    for first, triad in ((0, "accel"), (3, "gyro")):
        part, whole = change[:, first : first + 3], moved[:, first : first + 3]
        lsb = _refined(whole, step[first : first + 3])
        count, grid = _counts(part, lsb)
        every = _counts(whole, lsb)[1]
        # Differences of white noise have twice its variance; rounding adds a twelfth of a count².
        # Coarse ones are no more than two counts apart: what is, is where rests begin and end.
        # Some rests may be shaken: what most blocks have counts.
        square = np.square(np.minimum(count, 2.0))
        block = max(min(faults.BLOCK, len(square)), 1)
        whole_blocks = square[: len(square) // block * block].reshape(-1, block, 3)
        typical = np.median(whole_blocks.mean(axis=1), axis=0)
        noise = np.sqrt(np.maximum(typical / 2 - 1 / 12, 0.0))
        coarse = (lsb > finest[triad]) & (noise < _COARSE) & (grid.mean(axis=0) > 0.99)
        coarse &= every.mean(axis=0) > 0.99
        if coarse.any():
            names = tuple(CHANNELS[first + i] for i in np.flatnonzero(coarse))
            size = float(np.median(lsb[coarse]))
            found = {triad: 1.0, f"{triad}_lsb": size}
            out.append(_finding("quantization", recording, names, found))
    return out


def _refined(change: FloatArray, lsb: FloatArray) -> FloatArray:
    """Return the size of a count (3,) as changes of many counts (n, 3) tell it, step by step.

    A size that is off by a thousandth, as decimals make it, is off by half a count in 500.
    """
    for most in (4.0, 32.0, 256.0, 2048.0):
        count = np.rint(change / np.where(lsb > 0, lsb, 1.0))
        own = np.where(count <= most, count, 0.0)
        square = np.square(own).sum(axis=0)
        lsb = np.where(square > 0, (own * change).sum(axis=0) / np.maximum(square, 1.0), lsb)
    return np.asarray(lsb)


def _counts(change: FloatArray, lsb: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return changes (n, 3) in counts of `lsb`, and which are whole ones."""
    count = np.rint(change / np.where(lsb > 0, lsb, 1.0))
    return count, np.asarray(np.abs(change - count * lsb) < 0.01 * lsb)


def _finding(
    slug: str,
    recording: Recording,
    channels: tuple[str, ...],
    values: Mapping[str, float],
    note: str = "",
    intervals: tuple[Interval, ...] = (),
    spread: Mapping[str, float] | None = None,
) -> Finding:
    effect, known = get_effect(slug), spread or {}
    parameters = {
        name: Quantity(value, known.get(name), parameter_unit(f"{slug}.{name}"))
        for name, value in values.items()
    }
    sentence = f"{effect.sentence} {effect.in_words(values)}".rstrip()
    whole = ((float(recording.time[0]), float(recording.time[-1])),)
    return Finding(
        effect=slug,
        title=effect.title,
        kind=effect.kind,
        channels=channels,
        intervals=intervals or whole,
        regime=effect.follows,
        parameters=parameters,
        p_value=faults.FALSE_ALARM,
        absorbed_by=(),
        held_out=None,
        held_out_reason="it is seen in the samples themselves; no equation is fitted for it",
        rivals=(),
        to_separate="",
        sentence=f"{sentence} ({note})" if note else sentence,
    )


def intervals_of(time: FloatArray, index: IntArray) -> tuple[Interval, ...]:
    """Return the intervals that samples fill; at most `PLACES`, the closest ones joined."""
    at = time[index]
    return _cut(at, at, np.diff(at))


def _cut(first: FloatArray, last: FloatArray, gap: FloatArray) -> tuple[Interval, ...]:
    """Return at most `PLACES` intervals of things that begin and end at these times, in order."""
    cut = gap > _JOIN
    if cut.sum() >= PLACES:
        cut = gap > np.sort(gap)[-PLACES]
    edges = np.flatnonzero(cut)
    begin, end = np.append(0, edges + 1), np.append(edges, len(last) - 1)
    return tuple((float(first[a]), float(last[b])) for a, b in zip(begin, end, strict=True))
