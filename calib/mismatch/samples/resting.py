"""What the samples at rest show, and their means do not: lines, bursts, noise, pulses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calib.effects.base import Term
from calib.mismatch.findings.diagnosis import Finding, Unexplained
from calib.mismatch.samples.found import RESTLESS, SPIKES
from calib.mismatch.samples.hand import HAND, held_in_hand
from calib.mismatch.samples.spectrum import LINE, LOUDER_THERE, lines_of, look_at_spectrum
from calib.mismatch.samples.swings import look_for_swings
from calib.mismatch.samples.within import OFF_COURSE, PULSES, look_within
from calib.poses import Poses
from calib.recording import Recording

_SHAKEN = "_vibration_rectification"

_STEP = "_bias_step"


def look_at_rests(recording: Recording, poses: Poses) -> tuple[Unexplained, ...]:
    """Return lines, bursts, pulses and other disturbances of samples at rest."""
    if not len(poses):
        return ()
    fast = look_at_spectrum(recording, poses)
    within = look_within(recording, poses)
    found = [_as_long(line, within) for line in fast]
    found += [item for item in within if not _is_line(item, fast)]
    known = {channel for item in found for channel in item.channels}
    found += look_for_swings(recording, poses, known)
    return tuple(item for item in found if not _trembles(item, recording, poses))


def _trembles(item: Unexplained, recording: Recording, poses: Poses) -> bool:
    """Whether a line is no faster than a hand, which holds the sensor where it is seen."""
    lines = lines_of(item).values()
    return bool(lines) and max(lines) <= HAND[1] and held_in_hand([item], recording, poses)


def _as_long(item: Unexplained, others: Sequence[Unexplained]) -> Unexplained:
    """Return a line with all of the stretch in which its channel is restless by it.

    Where the pace of what makes it wanders, it is at one frequency for a part of that only.
    """
    (begin, end), *_ = item.intervals
    for other in others:
        if _is_line(other, [item]):
            (a, b), *_ = other.intervals
            begin, end = min(begin, a), max(end, b)
    return item if (begin, end) == item.intervals[0] else replace(item, intervals=((begin, end),))


def _is_line(item: Unexplained, lines: Sequence[Unexplained]) -> bool:
    """Whether a stretch is restless by a line that has been found on the same channel there."""
    return item.follows == RESTLESS and any(
        line.follows.startswith(LINE) and _meet(item, line) for line in lines
    )


def told_once(
    said: Sequence[Unexplained], noisy: Sequence[Unexplained]
) -> tuple[tuple[Unexplained, ...], tuple[Unexplained, ...]]:
    """Return what samples show, and what rests show, each large disturbance in one of them only.

    A line that rests show is in the words of these, and in the window of that.
    """
    left, own = list(noisy), []
    for item in said:
        same = [u for u in left if item.follows == RESTLESS and _meet(item, u)]
        lines = [u.follows for u in same if u.follows.startswith(LINE)]
        own.append(replace(item, follows=lines[0]) if lines else item)
        left = [u for u in left if u not in same]
    return tuple(own), tuple(left)


def _meet(item: Unexplained, other: Unexplained) -> bool:
    """Whether something is on channels of another one, where and when that is."""
    (a, b), *_ = item.intervals
    return set(item.channels) <= set(other.channels) and any(
        min(b, end) > max(a, begin) for begin, end in other.intervals
    )


def unsaid(
    noisy: Sequence[Unexplained],
    findings: Sequence[Finding],
    said: Sequence[Unexplained] = (),
    known: Sequence[Term] = (),
) -> tuple[Unexplained, ...]:
    """Return what is odd about samples at rest that findings are not the cause of.

    What shook the sensor is the cause of louder noise, too, also where what that does is ``known``
    from a calibration. Samples on both sides of a step of a bias have a spectrum, and a variance,
    of their own. Of a channel whose spikes were `said`, those that hardly stand out, or in turns
    alone, are no second thing.
    """
    out = []
    spiky = {c for item in said if item.follows == SPIKES for c in item.channels}
    causes = [f.effect for f in findings] + [term.effect for term in known]
    shaken = any(effect.endswith(_SHAKEN) for effect in causes)
    for item in noisy:
        if shaken and item.follows == LOUDER_THERE:
            continue
        if item.follows in (OFF_COURSE, PULSES) and spiky.issuperset(item.channels):
            continue
        moments = [
            f.parameters["moment"].value
            for f in findings
            if f.effect.endswith(_STEP) and set(f.channels) & set(item.channels)
        ]
        left = tuple((a, b) for a, b in item.intervals if not any(a <= t <= b for t in moments))
        if left:
            out.append(replace(item, intervals=left))
    return tuple(out)
