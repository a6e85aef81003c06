"""A long recording thinned to what a diagnosis uses, in memory that its length does not set.

A recording of up to `WHOLE` samples stays as it is. Of a longer one, which is read twice, remain:

- at most `choice.MOST` poses, those with the most unlike turns (`calib.mismatch.rows.choice`);
- of rests, `RESTING` samples in all. A long rest keeps windows of `WINDOW` samples, spread evenly
  over it. Averaging longer gains nothing: after a minute or two the mean of a rest is as good as
  the bias is stable (the floor of an Allan plot), and what the bias does in hours, with temperature
  or by itself, is seen at as many moments as there are windows;
- turns sample by sample. Of motion that is too long to be closed (`grid.LONGEST_TURN`) remain its
  first and last seconds, which tell when it began and ended.

What shows in single samples (clipping, repeats, stuck channels) is looked for in all of them,
section by section. Sections are cut by number of samples, so that nothing depends on the batches
in which the recording arrives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib import faults
from calib.measured import bridged, spikes_of
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.noise.hush import audible
from calib.mismatch.rows.choice import choose_poses
from calib.mismatch.rows.grid import LONGEST_TURN
from calib.mismatch.samples.found import Samples, intervals_of, join_samples, with_disagreement
from calib.mismatch.samples.reading import off_course, read_again
from calib.mismatch.samples.samples import look_at_faults, look_at_samples, outside_rests
from calib.mismatch.samples.units import look_at_units
from calib.poses import Poses, average_poses
from calib.read_once import read_once
from calib.recording import CHANNELS, Recording, join
from calib.statics import RestFinder, find_poses
from calib.timing import evened
from calib.types import BoolArray, IntArray

WHOLE = 1 << 19
"""Samples up to which a recording stays whole: 87 minutes at 100 Hz, 40 MB."""

SECTION = 1 << 17
"""Samples that are read and looked at together."""

RESTING = 1 << 18
"""Samples at rest that remain of a longer one: 44 minutes at 100 Hz."""

BESIDE = 64
"""Samples before and after a section that tell what was read again at its ends."""

WINDOW = 512
"""Samples that remain together: four periodograms of `calib.mismatch.samples.spectrum`."""

Batches = Callable[[], Iterable[Recording]]
"""Gives a recording batch by batch, from the start whenever it is called."""


_Section = tuple[Recording, tuple[Unexplained, ...], Samples]
"""Samples, what was odd about them, and which were read again."""


@dataclass(frozen=True, eq=False)
class Thinned:
    """What is left of a recording, and what was seen in all of it.

    Parameters
    ----------
    recording : Recording
        With what was left out counted in ``lost``.
    poses : Poses
        Of that recording.
    seen : Samples
        ``spoilt`` is of that recording.
    samples, start, duration, found : int, float (s), float (s), int
        Samples, first moment, duration and poses before anything was left out.
    """

    recording: Recording
    poses: Poses
    seen: Samples
    samples: int
    start: float
    duration: float
    found: int


def thin(
    batches: Batches,
    *,
    whole: int = WHOLE,
    section: int = SECTION,
    resting: int = RESTING,
    progress: Callable[[int], None] = lambda _: None,
) -> Thinned:
    """Return a recording thinned to what a diagnosis uses.

    Parameters
    ----------
    batches : function without arguments
        Returns the recording's batches in the order of time; called twice for a long one.
    whole, section, resting : int
        `WHOLE`, `SECTION`, `RESTING`.
    progress : function of int
        Told how many samples were read since it was told last.
    """
    head: list[Recording] = []
    finder: RestFinder | None = None
    told: dict[tuple[object, ...], Unexplained] = {}
    samples, first, last = 0, 0.0, 0.0
    again: list[Samples] = []
    spikes: list[IntArray] = []
    for part, what, twice in _sampled(batches(), section, progress, spikes):
        for left in what:
            key = left.channels, left.follows
            where = told[key].intervals if key in told else ()
            told[key] = replace(left, intervals=(*where, *left.intervals))
        again.append(twice)
        first = first if samples else float(part.time[0])
        last = float(part.time[-1])
        samples += len(part)
        if finder is None:
            head.append(part)
        if samples > whole and finder is None:
            finder = RestFinder(head[0])
            for held in head:
                finder.add(held)
            head.clear()
        elif finder is not None:
            finder.add(part)
    if finder is None:
        written = evened(join(head))
        recording = audible(written)
        poses = find_poses(recording)
        seen = _and(look_at_samples(written, poses), told.values(), again)
        return Thinned(recording, poses, seen, samples, first, recording.duration, len(poses))
    start, stop = finder.find()
    which = choose_poses(finder.accel(start, stop), start, stop, interval=finder.interval)
    keep = _kept(start[which], stop[which], finder.interval, resting)
    del finder  # a mean of every 0.1 s, which is no longer needed
    read = _sampled(batches(), section, progress, spikes)
    written, seen, index = _gather(read, keep, (start, stop))
    recording = audible(written)
    poses = average_poses(
        recording, np.searchsorted(index, start[which]), np.searchsorted(index, stop[which])
    )
    wrong, odd = look_at_units(recording, poses)
    seen = with_disagreement(seen, odd)
    if wrong:
        seen = seen._replace(findings=wrong, unexplained=(), fatal=True)
    seen = _and(seen, told.values(), again)
    return Thinned(recording, poses, seen, samples, first, last - first, len(start))


def _and(seen: Samples, odd: Iterable[Unexplained], again: list[Samples]) -> Samples:
    findings = (*join_samples(again).findings, *seen.findings)
    return seen._replace(findings=findings, unexplained=(*odd, *seen.unexplained))


def _sampled(
    batches: Iterable[Recording],
    section: int,
    progress: Callable[[int], None],
    known: list[IntArray],
) -> Iterator[_Section]:
    """Yield sections as sensors sampled them, what was odd there, and what was read again.

    Beside each are some samples of those before and after, so that it ends nowhere. The spikes of
    each are added to those `known`, and are not looked for again where they are.
    """
    number = 0
    before: tuple[Recording, ...] = ()
    parts = (_checked(each) for each in sections(batches, section))
    part, wild = next(parts, (None, ()))
    while part is not None:
        progress(len(part))
        following, further = next(parts, (None, ()))
        after = () if following is None else (following.slice(0, BESIDE),)
        whole = join((*before, part, *after))
        once, again = read_once(whole)
        begin = sum(map(len, before))
        own = slice(*np.searchsorted(again, [begin, begin + len(part)]).tolist())
        first, last = begin - own.start, begin + len(part) - own.stop
        if number == len(known):
            known.append(spikes_of(once))
        spikes = known[number]
        number += 1
        here = spikes[(spikes[:, 0] >= first) & (spikes[:, 0] < last)]
        odd = (*wild, *off_course(once, here))
        yield bridged(once, spikes).slice(first, last), odd, read_again(whole, again[own])
        before = (part.slice(max(len(part) - BESIDE, 0), len(part)),)
        part, wild = following, further


def _checked(recording: Recording) -> tuple[Recording, tuple[Unexplained, ...]]:
    good, wild = tamed(recording)
    faults.check_sizes(good, "the recording")
    return good, wild


def tamed(recording: Recording) -> tuple[Recording, tuple[Unexplained, ...]]:
    """Return the recording without samples that no sensor measures; they count as lost."""
    wild = faults.find_wild(faults.values_of(recording))
    if not wild.any():
        return recording, ()
    what = tuple(
        Unexplained(
            (CHANNELS[c],),
            intervals_of(recording.time, np.flatnonzero(wild[:, c])),
            "nothing: single samples are larger than any sensor measures",
            faults.FALSE_ALARM,
        )
        for c in np.flatnonzero(wild.any(axis=0))
    )
    keep: BoolArray = np.logical_not(wild.any(axis=1))
    if not keep.any():
        return recording, ()
    assert recording.lost is not None
    before = np.append(0, np.flatnonzero(keep)[:-1] + 1)
    until = np.flatnonzero(keep)[-1] + 1
    lost = np.add.reduceat(recording.lost[:until] + np.logical_not(keep[:until]), before)
    return replace(recording.select(keep), lost=lost), what


def sections(batches: Iterable[Recording], size: int) -> Iterator[Recording]:
    """Cut batches anew into sections of `size` samples; the last one is shorter."""
    held: list[Recording] = []
    count = 0
    for batch in batches:
        at = 0
        while at < len(batch):
            stop = min(len(batch), at + size - count)
            held.append(batch if stop - at == len(batch) else batch.slice(at, stop))
            count += stop - at
            at = stop
            if count == size:
                yield join(held)
                held, count = [], 0
    if held:
        yield join(held)


def _kept(start: IntArray, stop: IntArray, interval: float, resting: int) -> IntArray:
    """Return the ranges ``[start, stop)`` of samples that remain, (r, 2), in their order.

    Without a rest the first ones, which tell that there is none.
    """
    if not len(start):
        return np.array([[0, WINDOW]])
    most = _share(stop - start, resting)
    ranges: list[tuple[int, int]] = []
    for k, (a, b) in enumerate(zip(start.tolist(), stop.tolist(), strict=True)):
        if k:
            end = int(stop[k - 1])
            edge = int(0.6 * LONGEST_TURN / interval)
            long = a - end > 2 * edge
            ranges += [(end, end + edge), (a - edge, a)] if long else [(end, a)]
        if b - a <= most:
            ranges.append((a, b))
            continue
        for at in np.linspace(a, b - WINDOW, max(2, most // WINDOW)).astype(np.int64).tolist():
            ranges.append((at, at + WINDOW))
    return np.array(ranges, np.int64).reshape(-1, 2)


def _share(length: IntArray, total: int) -> int:
    """Return the length at which rests must be cut so that `total` samples are left."""
    if length.sum() <= total:
        return int(length.max(initial=0))
    order = np.sort(length)
    # With the k shortest whole, the others share what is left.
    each = (total - np.concatenate(([0], np.cumsum(order)[:-1]))) // np.arange(len(order), 0, -1)
    return max(int(each[np.argmax(order > each)]), 2 * WINDOW)


def _gather(
    read: Iterable[_Section], keep: IntArray, rests: tuple[IntArray, IntArray]
) -> tuple[Recording, Samples, IntArray]:
    """Return the samples that remain, what all of them show, and the numbers of those that remain.

    Parameters
    ----------
    keep : (r, 2) array of int
        Ranges that remain.
    rests : two (k,) arrays of int
        Start and stop of every rest, to tell where the sensor moves.
    """
    left: list[Recording] = []
    numbers: list[IntArray] = []
    seen: list[Samples] = []
    spoilt: list[BoolArray] = []
    offset, before = 0, None
    for once, _, _ in read:
        part = evened(once)
        # One sample more, so that no step from sample to sample is missed.
        whole = part if before is None else join((before, part))
        begin = offset + len(part) - len(whole)
        moving = outside_rests(whole, *rests, begin=begin)
        found = look_at_faults(whole, moving, whole=False)
        own = np.zeros(len(part), bool)
        for a, b in keep[(keep[:, 0] < offset + len(part)) & (keep[:, 1] > offset)] - offset:
            own[max(a, 0) : b] = True
        if own.any():
            left.append(part.select(own))
            numbers.append(np.flatnonzero(own) + offset)
            spoilt.append(found.spoilt[len(whole) - len(part) :][own])
        seen.append(found._replace(spoilt=np.zeros(0, bool)))
        before = part.slice(len(part) - 1, len(part))
        offset += len(part)
    index = np.concatenate(numbers)
    recording = join(left)
    assert recording.lost is not None
    cut = np.diff(index, prepend=index[0] - 1) - 1
    # No turn may be integrated across what was left out.
    merged = join_samples(seen)._replace(spoilt=np.concatenate(spoilt) | (cut > 0))
    return replace(recording, lost=recording.lost + cut), merged, index
