"""A triad that turns against the other: a mounting, or glue, that gives way.

The axes of one triad turn by a small rotation vector v against those of the other, so that its
output ``s`` gains ``s x v``: in a window, or for good from a moment on, at once or at a steady
pace. A turn that was there throughout is a misalignment, which has a name; so has all but the first
quarter of one, as far as a recording tells, and no window begins with the recording.

Beside a truth both may turn against that, as the sensor slips in its mount. That they are turned
throughout is a misalignment to the reference, which is fitted always: so a slip may be early.

An accelerometer that turns at rest shows it at once, as gravity moves across it: it may turn in
every part of a rest. A gyroscope shows it in turns alone.

Columns are sums from a moment to the end: a window is the difference of two of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.windows import (
    RAMP,
    SLIPPED,
    TURNED,
    Slots,
    carried,
    function_of_time,
    make_slots,
    typical_size,
    windows,
)
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

EARLIEST = 0.25
"""Share of the recording before the first moment at which a triad may turn for good."""

SHORTEST = 3
"""Segments (or twice as many parts of them) in a window, fewest: a turn is known from several."""

_TRIADS = ((TURNED, CHANNELS[:3]), (TURNED, CHANNELS[3:]))

AND_BACK = np.repeat(np.eye(3), 2, axis=0) * np.tile([[1.0], [-1.0]], (3, 1))
"""What is made of the sums from two moments on, about each axis. What is turned for good has the
sums from one on as they are, and at a pace those of a ramp beside them."""


def turned_axes(stack: Stack, rows: Rows, weight: float) -> Iterator[Candidate]:
    """Yield every window and moment in which either triad may have turned.

    Their columns are added to the stack; their weights sum to `weight`. Windows of one length, and
    what is turned for good at once, and at a pace, have the same share.
    """
    turning = ((SLIPPED, CHANNELS), *_TRIADS) if rows.aligned else _TRIADS
    for name, triad in turning:
        slots = _slots(rows, triad)
        start = _starts(rows, slots)
        shortest = SHORTEST if len(start) == len(rows.interval) else 2 * SHORTEST
        plain, paced = _add(stack, rows, slots, triad)
        end, number = float(rows.interval[-1, 1]), len(start)
        found = [
            (b - a, (float(start[a]), float(start[b])), plain[:, [a, b]], AND_BACK)
            for a, b in windows(number)
            if a > 0 and b < number and b - a >= shortest
        ]
        earliest = 0.0 if name == SLIPPED else EARLIEST
        for k in range(max(int(earliest * number), 1), number):
            found.append((0, (float(start[k]), end), plain[:, [k]], None))
            if k in slots.first:
                both = np.stack((plain[:, k], paced[:, k]), axis=1)
                found.append((-1, (float(start[k]), end), both, None))
        parts = Counter(part for part, *_ in found)
        for part, interval, index, mixing in found:
            yield Candidate(
                name,
                index.ravel(),
                weight / len(turning) / len(parts) / parts[part],
                False,
                triad,
                shape=dict(RAMP) if part < 0 else {},
                interval=interval,
                mixing=mixing,
            )


def turned_parts(rows: Rows, candidate: Candidate) -> tuple[FloatArray, FloatArray]:
    """Return the edges (n + 1,) of what axes turn in, and the (m, n, k) columns of each part."""
    slots = _slots(rows, candidate.channels)
    assert candidate.interval is not None
    pace = function_of_time(candidate.shape, rows.state.time, *candidate.interval)
    parts = [each for own in pace.T for each in _in_slots(rows, slots, candidate.channels, own)]
    edges = np.append(_starts(rows, slots), rows.interval[-1, 1])
    return edges, np.stack(parts, axis=2)


def _slots(rows: Rows, triad: tuple[str, ...]) -> Slots:
    return make_slots(rows, coarse=triad[0].startswith("gyro"))


def _starts(rows: Rows, slots: Slots) -> FloatArray:
    """Return when each slot begins, (n,) s."""
    each = np.diff(slots.first)
    part = np.arange(slots.first[-1]) - np.repeat(slots.first[:-1], each)
    start, stop = np.repeat(rows.interval, each, axis=0).T
    return np.asarray(start + part / np.repeat(each, each) * (stop - start))


def _in_slots(
    rows: Rows, slots: Slots, triad: tuple[str, ...], pace: FloatArray
) -> list[FloatArray]:
    """Return the (m, n) columns of a turn about each axis, (n,) times as fast, in each slot."""
    size = typical_size(triad[0].split(".")[0])
    name = SLIPPED if len(triad) == len(CHANNELS) else TURNED
    about = Candidate(name, np.zeros(0, np.int64), 0.0, False, triad)
    out = []
    for carriers in carried(rows.state, about):
        columns = np.zeros((len(rows.residual), slots.first[-1]))
        for c, of in carriers:
            own = slots.member.multiply((size * of * pace)[:, None])
            columns += (rows.functional[c] @ own).toarray()
        out.append(columns)
    return out


def _add(
    stack: Stack, rows: Rows, slots: Slots, triad: tuple[str, ...]
) -> tuple[IntArray, IntArray]:
    """Add what a turn about each axis shows from each slot on; return the (3, n) columns.

    And of a turn at a pace of two in the recording.
    """
    touched = rows.touched([CHANNELS.index(c) for c in triad])
    time = rows.state.time
    pace = function_of_time(RAMP, time, float(time[0]), float(time[-1]))
    out = []
    for own in pace.T:
        later = [
            np.cumsum(columns[:, ::-1], axis=1)[:, ::-1]
            for columns in _in_slots(rows, slots, triad, own)
        ]
        out.append(np.stack([stack.columns.add(columns, touched) for columns in later]))
    return out[0], out[1]
