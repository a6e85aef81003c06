"""Honest rivals: what a residual may follow without being physics that we know.

They compete with the catalogue on the same terms. When one wins, the answer is "unexplained: this
channel, this span or regime, follows this", and not the nearest name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from calib.effects import effects
from calib.mismatch.hypotheses.candidates import (
    DELAY,
    FLUCTUATING,
    GAIN,
    GAIN_IN_TIME,
    GAINS,
    MOVING,
    Bank,
    Candidate,
)
from calib.mismatch.hypotheses.followed import (
    LEVEL,
    OWN_RIPPLES,
    RIPPLES,
    axes,
    other_rates,
    own_rate,
    paired_rates,
    past_levels,
    ripples,
    sign_of,
    smooth,
    warmed,
    wave,
)
from calib.mismatch.hypotheses.remembered import (
    LOADED,
    Stretches,
    after_turns,
    creeping,
    history,
    lagging,
    of_use,
    remembered,
)
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.turned import turned_axes
from calib.mismatch.hypotheses.windows import (
    APART,
    CORNERS,
    FLUCTUATION,
    MIDDLE,
    THROUGHOUT,
    TURNED,
    Local,
    Slots,
    gains_in_time,
    in_segments,
    in_windows,
    is_step,
    make_slots,
    own_signal,
    own_slope,
    throughout,
    typical_size,
)
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

RIVAL = 0.4
"""Prior probability of all rivals together."""

FROM_START = "fading from the start"

SIGN = "the sign of its output"
"""What is cut towards zero instead of rounded, or has a step or a dead zone there, follows that."""

_KINDS = {
    "bias in a window": 0.12,
    MOVING: 0.02,
    GAIN: 0.08,
    GAIN_IN_TIME: 0.02,
    FLUCTUATING: 0.14,
    "wave in a window": 0.1,
    DELAY: 0.01,
    THROUGHOUT: 0.03,
    "time": 0.02,
    "temperature": 0.02,
    "direction of gravity": 0.09,
    "orientation": 0.025,
    "speed of rotation": 0.045,
    "its own rate": 0.02,
    "rate about the other axes": 0.02,
    "rate and direction of gravity": 0.01,
    "the pose before": 0.015,
    LOADED: 0.015,
    "the turn before": 0.01,
    "time since the last turn": 0.01,
    "temperature and direction of gravity": 0.005,
    "temperature and rate about the other axes": 0.005,
    SIGN: 0.01,
    LEVEL: 0.01,
    FROM_START: 0.015,
}
"""Share of each. What follows temperature, time or its own rate smoothly has names in the
catalogue, or is drift: only odd shapes are left."""

_OF_TRIADS = {
    "bias in a window": 0.02,
    GAIN: 0.02,
    FLUCTUATING: 0.04,
    MOVING: 0.01,
    TURNED: 0.02,
    FROM_START: 0.015,
    SIGN: 0.01,
}
"""The same for what three channels have at once: their supply, cable or package."""

LATE = 12
"""Segments in a window that a channel is late in without a truth, fewest: six turns. Of fewer that
do not close, for any reason, some delay would make most."""

FADING = np.geomspace(1.0, 16.0, 7)
"""s in which what disturbed the first rest fades: a hand has let go, a cable or a stand gives way.
That is what warming up looks like; only it takes longer, and shows in other rests too."""

FADED = 3.0
"""Time constants after which it is gone."""

_Draft = tuple[str, str, IntArray, Mapping[str, Any]]
"""The part of its kind that a candidate belongs to, its name, index, and the rest."""


class _Layout(NamedTuple):
    """Where columns are in the stack: the first `width` are those in windows of the first channel.

    Of these `slots` are parts of time, then come the signal and its slope in each
    of the `segments`; and then the other channels'. A channel is `late` in so many segments at
    least. ``smooth`` has what a rival follows, the channel, and its columns ``[first, stop)``.
    """

    slots: int
    segments: int
    late: int
    width: int
    smooth: tuple[tuple[str, int, int, int], ...]


def add_rivals(stack: Stack, rows: Rows, *, skip: tuple[str, ...] = ()) -> None:
    """Add every rival that these rows can show, with weights that sum to at most `RIVAL`.

    ``skip`` names those that are not tried (``time`` where the clock is wrong).
    """
    slots = make_slots(rows)
    layout = _add_columns(stack, rows, slots, delays=DELAY not in skip)
    times = rows.interval.tobytes(), slots.middle.tobytes(), slots.first.tobytes()
    banks, weights = _sorted(*times, layout, skip)
    for bank in banks:
        stack.extend(bank)
    if "time" not in skip:
        stack.add(*_fading(stack, rows))
    if "time" not in skip:
        stack.add(*turned_axes(stack, rows, RIVAL * _OF_TRIADS[TURNED]))
    if "direction of gravity" in skip:
        return
    up = _up(rows, slots)
    every = list(ripples(up))
    for c, channel in enumerate(CHANNELS):
        parts = c * layout.width + np.arange(layout.slots)
        own = [(ripple, wave(ripple * up[:, c])) for ripple in OWN_RIPPLES.tolist() if c < 3]
        stack.add(
            *(
                Candidate(
                    "direction of gravity", parts, weights[ripple], False, (channel,), mixing=mixing
                )
                for ripple, mixing in [*every, *own]
            )
        )


def _add_columns(stack: Stack, rows: Rows, slots: Slots, *, delays: bool) -> _Layout:
    """Add the columns of all rivals: those in windows, then smooth functions of something."""
    state, follow = rows.state, list[tuple[str, int, int, int]]()
    touched = [rows.touched([c]) for c in range(len(CHANNELS))]
    sizes = [typical_size(name.split(".")[0]) for name in CHANNELS]
    for c, size in enumerate(sizes):
        in_slots = (rows.functional[c] @ slots.member).toarray()
        stack.columns.add(size * in_slots, touched[c])
        signal = in_segments(rows, c, own_signal(state, c))
        stack.columns.add(size * signal, touched[c])
        if delays:
            stack.columns.add(size * in_segments(rows, c, own_slope(state, c)), touched[c])
    segments = signal.shape[1]
    width = in_slots.shape[1] + (2 if delays else 1) * segments
    stretches = Stretches.of(rows)
    before = [*history(rows, stretches), *of_use(rows, stretches), *lagging(rows)]
    followed = [*smooth(state), *before]
    loaded = [list(remembered(stretches, axis)) for axis in range(3)]
    for c, size in enumerate(sizes):
        own = [("its own rate", own_rate(state, c))]
        own += [("rate about the other axes", f(state, c)) for f in (other_rates, paired_rates)]
        own += [
            (SIGN, sign_of(rows, c)),
            *warmed(state, c),
            *loaded[c % 3],
            *past_levels(rows, c),
        ]
        own += (creeping if c < 3 else after_turns)(rows, stretches, c)
        found = [(label, rows.columns(c, values)) for label, values in [*followed, *own]]
        index = stack.columns.add(size * np.hstack([columns for _, columns in found]), touched[c])
        ends = index[0] + np.cumsum([0, *(columns.shape[1] for _, columns in found)])
        for (label, _), (first, last) in zip(found, pairwise(ends.tolist()), strict=True):
            follow.append((label, c, first, last))
    late = LATE if rows.is_rest.any() else 1
    return _Layout(in_slots.shape[1], segments, late, width, tuple(follow))


@lru_cache(maxsize=1)
def _sorted(
    interval: bytes,
    middle: bytes,
    first: bytes,
    layout: _Layout,
    skip: tuple[str, ...],
) -> tuple[list[Bank], dict[float, float]]:
    """Return all candidates but ripples, and the weight of one of each ripple.

    They depend on when segments were, which no fit changes: from round to round they are the same.
    And from channel to channel: they are made for one, and moved.
    """
    times = np.frombuffer(interval).reshape(-1, 2)
    slots = np.frombuffer(middle), np.frombuffer(first, np.int64)
    local = [*in_windows(times, *slots, CORNERS, waves=True), *gains_in_time(times)]
    local = [w for w in local if w.name != DELAY or w.window[1] - w.window[0] >= layout.late]
    joint = [
        _of_triad(item, slots[1])
        for item in in_windows(times, *slots, MIDDLE, waves=False)
        if item.name in _OF_TRIADS and item.shape != APART
        if item.name == "bias in a window" or item.window[1] - item.window[0] >= FLUCTUATION
    ]
    # Beside the bias, a window that is open at one end is a step of it, which has a name.
    steps = {"accel_bias_step", "gyro_bias_step"} <= effects().keys() - set(skip)
    local, joint = (
        [w for w in items if w.name not in skip and not (steps and is_step(w, len(times)))]
        for items in (local, joint)
    )
    waves = throughout(times, slots[0])
    alone = *_drafts(1, layout, slots[1], local), *_waves(layout, waves)
    drafts = {
        many: [draft for draft in found if draft[1] not in skip]
        for many, found in ((1, alone), (3, _drafts(3, layout, slots[1], joint)))
    }
    followed = [item for item in layout.smooth if item[0] in _KINDS and item[0] not in skip]
    # Every kind has its share, each of its parts (one length of window, say) the same of that.
    number = Counter[tuple[str, int, str]]()
    for many, found in drafts.items():
        for part, name, *_ in found:
            number[name, many, part] += len(CHANNELS) // many
    for name, *_ in followed:
        number[name, 1, "smooth"] += 1
        if name == SIGN:
            number[name, 3, "smooth"] = 2
        if name == "direction of gravity":
            number[name, 1, "quadratic"] += 1
    if "direction of gravity" not in skip:
        for ripple in (0.0, *RIPPLES):
            count = len(CHANNELS) * len(axes(ripple))
            number["direction of gravity", 1, f"ripple {ripple}"] = count
        number["direction of gravity", 1, "own ripples"] = 3 * len(OWN_RIPPLES)
    lengths = Counter((name, many) for name, many, _ in number)

    def weight(name: str, many: int, part: str) -> float:
        share = (_KINDS if many == 1 else _OF_TRIADS)[name]
        return RIVAL * share / lengths[name, many] / number[name, many, part]

    banks = []
    for many, found in drafts.items():
        bank = Bank(
            [
                Candidate(name, index, weight(name, many, part), False, CHANNELS[:many], **about)
                for part, name, index, about in found
            ]
        )
        for c in range(0, len(CHANNELS), many):
            banks.append(bank.moved(CHANNELS[c : c + many], c * layout.width))
    banks.append(Bank(list(_smooth(followed, weight))))
    if "direction of gravity" in skip:
        return banks, {}
    known = {r: weight("direction of gravity", 1, f"ripple {r}") for r in (0.0, *RIPPLES)}
    known |= dict.fromkeys(OWN_RIPPLES.tolist(), weight("direction of gravity", 1, "own ripples"))
    return banks, known


def _drafts(many: int, layout: _Layout, first: IntArray, local: list[Local]) -> Iterator[_Draft]:
    """Yield what windows may hold on the first channel, or on as `many`."""
    later = layout.width * np.arange(many)
    every = np.arange(layout.width)
    slots = first.tolist()
    for item in local:
        a, b = item.window
        low, high = slots[a], slots[b]
        if item.name in GAINS:
            low, high = layout.slots + a, layout.slots + b
        elif item.name == DELAY:
            later_on = layout.slots + layout.segments
            low, high = later_on + a, later_on + b
        index = every[low:high]
        about = {
            "summed": item.mixing is None,
            "interval": item.interval,
            "shape": item.shape,
            "mixing": item.mixing,
        }
        whole = index if many == 1 else (later[:, None] + index).ravel()
        yield item.part or f"{b - a} segments", item.name, whole, about


def _waves(
    layout: _Layout, waves: Iterator[tuple[dict[str, float], FloatArray]]
) -> Iterator[_Draft]:
    """Yield waves that a channel has throughout."""
    index = np.arange(layout.slots)
    for shape, mixing in waves:
        yield "throughout", THROUGHOUT, index, {"shape": shape, "mixing": mixing}


def _smooth(
    followed: list[tuple[str, int, int, int]], weight: Callable[[str, int, str], float]
) -> Iterator[Candidate]:
    """Yield what follows something smoothly on a channel."""
    for name, c, start, stop in followed:
        every, channels = np.arange(start, stop), (CHANNELS[c],)
        yield Candidate(name, every, weight(name, 1, "smooth"), False, channels)
        if name == SIGN and not c % 3:
            # A host cuts all axes of a triad alike.
            each = [a for label, k, a, _ in followed if label == SIGN and c <= k < c + 3]
            joint = weight(name, 3, "smooth")
            yield Candidate(name, np.array(each), joint, False, CHANNELS[c : c + 3], summed=True)
        if name == "direction of gravity":
            # Harmonics come in the order of their degree: 3 + 6 of degrees 1 and 2.
            yield Candidate(name, every[:9], weight(name, 1, "quadratic"), False, channels)


def _of_triad(item: Local, first: IntArray) -> Local:
    """Return what three channels have at once, each in a way of its own; but one gain."""
    if item.name == GAIN:
        mixing = item.mixing
        return item if mixing is None else replace(item, mixing=np.tile(mixing, (3, 1)))
    a, b = item.window
    mixing = np.ones((first[b] - first[a], 1)) if item.mixing is None else item.mixing
    n, k = mixing.shape
    each = np.zeros((3, n, 3, k))
    each[range(3), :, range(3)] = mixing
    return replace(item, mixing=each.reshape(3 * n, -1))


def _fading(stack: Stack, rows: Rows) -> Iterator[Candidate]:
    """Yield what a channel, or a triad, may have from the recording's start on, while it fades."""
    began, share = rows.state.power_on, RIVAL / len(FADING)
    every, alone = _OF_TRIADS[FROM_START] * share / 2, _KINDS[FROM_START] * share / len(CHANNELS)
    shapes = np.exp(-(rows.state.time - began)[:, None] / FADING)
    for triad in (CHANNELS[:3], CHANNELS[3:]):
        size = typical_size(triad[0].split(".")[0])
        index = np.stack(
            [
                stack.columns.add(size * rows.columns(c, shapes), rows.touched([c]))
                for c in map(CHANNELS.index, triad)
            ]
        )
        for k, tau in enumerate(FADING.tolist()):
            interval = (began, began + FADED * tau)
            yield Candidate(FROM_START, index[:, k], every, False, triad, interval=interval)
            for channel, own in zip(triad, index[:, k : k + 1], strict=True):
                yield Candidate(FROM_START, own, alone, False, (channel,), interval=interval)


def _up(rows: Rows, slots: Slots) -> FloatArray:
    """Return the mean direction of gravity in each slot, (n, 3)."""
    count = np.maximum(slots.member.sum(axis=0).A1, 1.0)
    return np.asarray((slots.member.T @ rows.state.gravity_direction) / count[:, None])
