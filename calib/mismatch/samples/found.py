"""What was found in samples: how it is said, where, and how parts of a recording are joined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib import faults
from calib.calibration import Quantity, parameter_unit
from calib.effects import get_effect
from calib.mismatch.findings.diagnosis import Finding, Interval, Unexplained
from calib.recording import CHANNELS, Recording
from calib.types import BoolArray, FloatArray, IntArray

_JOIN = 1.0
"""Places closer than this are one interval, s."""

PLACES = 50
"""Intervals that are told apart, at most."""

BEYOND = "nothing: no gyroscope reads that at rest"

PUSHED = "motion: nothing that rests in between is pushed so hard"
"""What is unexplained where most turns reach a specific force that nothing measures."""

DISAGREES = "turns: by the gyroscope they are others than by the accelerometer"
"""What is unexplained where neither a unit nor an order of axes explains most turns."""

COPIED = "nothing: one repeats the other"

SPIKES = "nothing: samples are off course, and back at once"

FROZEN = "nothing: it is stuck"

SWAPPED = "nothing: samples are not in the order they were taken in"

RESTLESS = "the time: it is restless there"
"""What a channel follows that is alone with a disturbance, for a part of the time or throughout."""

GATED = "nothing: it is set to one value at rest"

WRAPPED = "nothing: it wraps around at the end of its range"

WEIGHTLESS = "nothing: it would have been falling"

STUCK_BIT = "nothing: a bit of its counts never changes"

NEEDED = {
    DISAGREES: "a gyroscope and an accelerometer that agree on the turns",
    BEYOND: "a gyroscope that reads less at rest",
    PUSHED: "an accelerometer that reads what moves it: a cable or a register gives something else",
    COPIED: "channels of their own: a register may be read twice",
    GATED: "a gyroscope as it is at rest: its driver has a dead band, or sets it to zero there",
    STUCK_BIT: "counts with all of their bits: a line of a bus may be broken, or a mask wrong",
    RESTLESS: "a channel that is still at rest, as the other five are",
}
"""What a recording lacks that ends with its samples, by what they are off by."""

STUCK = 0.2
"""Share of the recording for which a channel that is stuck leaves nothing to compare with."""


class Samples(NamedTuple):
    """What the samples show. ``fatal`` means that nothing else can be said until it is mended.

    ``spoilt`` marks samples that no model of the sensor can explain: a turn with one is not closed.
    ``stuck`` counts the samples at which a channel is stuck, of ``told`` where that can be seen;
    ``restless`` those at which one channel alone is disturbed by far more than its noise.
    """

    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    spoilt: BoolArray
    fatal: bool
    stuck: int = 0
    told: int = 0
    restless: int = 0

    @property
    def need(self) -> str:
        """What must be mended first where they are fatal."""
        need = "units and axes that are right"
        if any(f.effect == "time_offset" for f in self.findings):
            need = "a gyroscope and an accelerometer on one clock"
        if self.unexplained:
            last = self.unexplained[-1]
            many = {1: "one is", len(CHANNELS): "all are"}.get(len(last.channels), "some are")
            need = NEEDED.get(last.follows, f"channels that move: {many} stuck")
        return f"{need}: mend that and diagnose again"


def with_disagreement(seen: Samples, odd: tuple[Unexplained, ...]) -> Samples:
    """Return what the samples show with turns that disagree, if nothing seen in them does it."""
    known = {f.effect for f in seen.findings} & {"saturation", "dropped_samples"}
    # A channel that repeats another one reads too little in some poses.
    others = [u for u in seen.unexplained if u.follows != WEIGHTLESS]
    if not odd or others or (known and odd[0].follows == DISAGREES):
        return seen
    return seen._replace(unexplained=odd, fatal=True)


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
                intervals=join_intervals([i for item in items for i in item.intervals]),
                parameters={name: _common(name, found) for name, found in values.items()},
                p_value=chance,
            )
        )
    unexplained = [
        Unexplained(names, (where,), follows, chance)
        for (names, follows), intervals in odd.items()
        for where in join_intervals(intervals)
    ]
    stuck, told, restless = (
        sum(getattr(part, name) for part in parts) for name in ("stuck", "told", "restless")
    )
    none, fatal = np.zeros(0, bool), stuck > STUCK * told
    return Samples(tuple(findings), tuple(unexplained), none, fatal, stuck, told, restless)


def _common(name: str, found: list[Quantity]) -> Quantity:
    """Return what one parameter of a fault is over several parts of a recording."""
    values = [q.value for q in found]
    value = sum(values) if name == "count" else min(values) if name == "moment" else max(values)
    return replace(found[0], value=value)


def fault_finding(
    slug: str,
    recording: Recording,
    channels: tuple[str, ...],
    values: Mapping[str, float],
    note: str = "",
    intervals: tuple[Interval, ...] = (),
    spread: Mapping[str, float] | None = None,
) -> Finding:
    """Return the finding of a fault that is seen in the samples, with these parameters."""
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


def join_intervals(found: list[Interval]) -> tuple[Interval, ...]:
    """Return intervals in their order, those joined that meet; at most `PLACES`."""
    first, last = np.array(sorted(found)).T
    return _cut(first, last, first[1:] - last[:-1])


def _cut(first: FloatArray, last: FloatArray, gap: FloatArray) -> tuple[Interval, ...]:
    """Return at most `PLACES` intervals of things that begin and end at these times, in order."""
    cut = gap > _JOIN
    if cut.sum() >= PLACES:
        cut = gap > np.sort(gap)[-PLACES]
    edges = np.flatnonzero(cut)
    begin, end = np.append(0, edges + 1), np.append(edges, len(last) - 1)
    return tuple((float(first[a]), float(last[b])) for a, b in zip(begin, end, strict=True))
