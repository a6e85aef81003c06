"""Whether an effect acts throughout, or in a part of the recording only.

A sensor's term acts in every pose and turn. What was there for a while (a magnet was near, a screw
had come loose, a filter was set anew) looks like a term of an averaged size, and its standard error
says nothing of that. So a finding that follows the motion is judged in every window of the
recording as well: what it does there, and nothing outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, softmax

from calib.effects import get_effect
from calib.mismatch.findings.diagnosis import Interval
from calib.mismatch.hypotheses.ends import expected_overlap, of_place, of_windows
from calib.mismatch.noise.noise import make_whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, fitted, lasting
from calib.types import FloatArray

SELDOM = 0.05
"""How probable it is that what looks like a term acts in a part only, rather than throughout."""

SURE = 20.0
"""Odds from which on it does."""

OUTSIDE = 0.25
"""Share of what it would do throughout that a part leaves out, at least: without one turn that
closes badly anything fits better."""

STAYS = 1.0
"""How probable it is that it began, or ended, for good, to that it did both."""

IN_A_PART = "in a part of the recording"

_IN_TIME = ("time", "temperature", "variance")
"""What follows these has a course of its own in time."""


class Part(NamedTuple):
    """When an effect acts, and how many times less probable it is that it does throughout."""

    interval: Interval
    odds: float


def acting_part(
    rows: Rows,
    accepted: Sequence[Accepted],
    which: int,
    levels: FloatArray,
    contrast: FloatArray,
) -> Part | None:
    """Return the part of the recording in which one finding acts, if it does not throughout.

    The rows have the part of every finding in them.
    """
    own = accepted[which]
    if not lasting(own.candidate) or (own.candidate.shape and not own.candidate.present):
        return None
    effect = get_effect(own.candidate.name)
    if effect.kind != "sensor" or any(word in effect.follows for word in _IN_TIME):
        return None
    others = [a for i, a in enumerate(accepted) if i != which]
    whitener = make_whitener(rows, levels, contrast, fitted(rows, others))
    y = whitener.project(rows.residual)
    number = len(rows.interval)
    here = rows.segment[:, None] == np.arange(number)
    parts = own.columns[:, None, :] * here[:, :, None]
    white = whitener.project(parts.reshape(len(y), -1)).reshape(parts.shape)
    share = np.append(0.0, np.cumsum(np.square(white).sum(axis=(0, 2))))
    first, last = np.triu_indices(number + 1, 1)
    some = share[-1] - (share[last] - share[first]) >= OUTSIDE * share[-1]
    whole = (first == 0) & (last == number)
    if not some.any():
        return None
    value = of_windows(white, y, first[some | whole], last[some | whole])
    all_of_it = float(value[whole[some | whole]][0])
    first, last, value = first[some], last[some], value[some[some | whole]]
    weight = value + of_place(first, last, number, STAYS)
    ahead = float(logsumexp(weight)) + float(np.log(SELDOM)) - all_of_it
    if ahead < np.log(SURE):
        return None
    where = expected_overlap(rows.interval[first, 0], rows.interval[last - 1, 1], softmax(weight))
    return Part(where, float(np.exp(min(ahead, 700.0))))
