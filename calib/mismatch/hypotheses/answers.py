"""The candidates of a stack as answers: groups of them, the best of each, and what is near.

All shapes and places of an effect, or of a rival on one channel, are one answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from calib.effects import get_effect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns, neighbours
from calib.mismatch.hypotheses.peak import close_in
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.windows import WINDOWED, moved_window, nearby_windows, window_columns
from calib.mismatch.noise.noise import Whitener
from calib.mismatch.rows.rows import Rows
from calib.types import FloatArray

LEADERS = (4, 3)
"""How many of the best, of physics and of rivals, are scored at places nearer to their own, with
noise levels of their own."""


STRONG = 20.0
"""Log B from which what is near may be too far."""


def grouped(stack: Stack, evidence: FloatArray) -> tuple[dict[str, Candidate], dict[str, float]]:
    """Return the best candidate of each group, and the group's evidence; none of -inf alone."""
    names, code = stack.groups()
    top = np.full(len(names), -np.inf)
    np.maximum.at(top, code, evidence)
    highest = np.flatnonzero(evidence == top[code])
    best = highest[np.unique(code[highest], return_index=True)[1]]
    total = np.bincount(code, np.exp(evidence - np.where(top > -np.inf, top, 0.0)[code]))
    found = np.flatnonzero(top > -np.inf).tolist()
    return (
        {names[k]: stack[int(best[k])] for k in found},
        {names[k]: float(top[k] + np.log(total[k])) for k in found},
    )


def leading(best: Mapping[str, Candidate], groups: Mapping[str, float]) -> list[str]:
    """Return the groups with the most evidence."""
    order = sorted(groups, key=lambda g: -groups[g])
    physics, rivals = ([g for g in order if best[g].physical is kind] for kind in (True, False))
    return physics[: LEADERS[0]] + rivals[: LEADERS[1]]


def strongest_rivals(stack: Stack, evidence: FloatArray) -> dict[tuple[str, ...], Candidate]:
    """Return the rival with the largest Bayes factor of each channel, and of each triad."""
    best: dict[tuple[str, ...], int] = {}
    at = 0
    for bank in stack.banks:
        rivals = np.flatnonzero(~bank.physical)
        for k, channels in enumerate(bank.channels):
            own = at + rivals[bank.channel[rivals] == k]
            if len(own):
                top = int(own[np.argmax(evidence[own])])
                if evidence[top] > evidence[best.setdefault(channels, top)]:
                    best[channels] = top
        at += len(bank)
    return {channels: stack[i] for channels, i in best.items()}


def physics(stack: Stack) -> FloatArray:
    """Return the physical columns, thinned where an effect has many shapes."""
    index: list[int] = []
    shapes: dict[str, list[Candidate]] = {}
    for c in stack.physics.values():
        # Every parameter is tried alone, but for refinements of others.
        if c.is_single:
            shapes.setdefault(c.name, []).append(c)
    for items in shapes.values():
        each = list(dict.fromkeys(int(k) for c in items for k in c.index))
        limit = 6
        index += each if len(each) <= limit else each[:: -(-len(each) // limit)]
    return stack.columns.take(np.array(index, np.int64))


def nearby(rows: Rows, leader: Candidate) -> Stack:
    """Return a candidate at the shapes and places nearest to its own; nothing for what has none.

    An event is moved within its rest or turn and those beside it, a time constant between its
    neighbours on the grid, a window at both of its ends.
    """
    stack = Stack(len(rows.residual))
    if leader.physical and not leader.present:
        for shape in neighbours(get_effect(leader.name), rows, leader.shape):
            _add_at(stack, rows, leader, shape)
    if leader.name in WINDOWED:
        for window in nearby_windows(rows, leader):
            there = moved_window(leader, *window)
            index = stack.columns.add(window_columns(rows, there))
            stack.add(replace(there, index=index, mixing=None, summed=False))
    return stack


def evidence_near(
    rows: Rows, near: Stack, whitener: Whitener, y: FloatArray, *, strong: float = STRONG
) -> float:
    """Return log B of what is near as one candidate, each as probable as any other.

    A candidate with a moment stands for its rest or turn: of the moments they are those of the rest
    or turn that says most. Strong evidence is so narrow that all that is near may miss it: there it
    is that about its peak, if that is more.

    Parameters
    ----------
    rows : Rows
    near : Stack
        From `nearby`.
    whitener : Whitener
    y : (m,) array
        Whitened projected residual.
    strong : float
        Log B from which the peak is sought.
    """
    factors = near.log_bayes_factors(whitener, y)
    average = _average(rows, near, factors)
    best = int(np.argmax(factors))
    if not near[best].physical or factors[best] < strong:
        return average
    peak = _peak(rows, near, best, float(factors[best]), whitener, y)
    if peak is None:
        return average
    # By Laplace's method a peak counts by its width, which of a shape that explains much is about
    # this share of what it may be.
    return max(average, peak - 0.5 * float(np.log(max(2.0 * peak, 1.0))))


def _average(rows: Rows, near: Stack, factors: FloatArray) -> float:
    """Return log B averaged over what is near, of moments over the rest or turn that says most."""
    moments = np.array([c.shape.get("moment", -np.inf) for c in near])
    place = np.searchsorted(rows.interval[:, 0], moments, side="right")
    return max(
        float(logsumexp(factors[place == k]) - np.log((place == k).sum())) for k in np.unique(place)
    )


def _peak(
    rows: Rows, near: Stack, best: int, value: float, whitener: Whitener, y: FloatArray
) -> float | None:
    """Return the highest log B about the best of what is near, closing in on it from its `value`.

    None of what has not one shape or moment.
    """
    leader = near[best]
    shape = [i for i in get_effect(leader.name).shape if i.name in leader.shape]
    own = [i for i in shape if i.spacing != "integer"]
    if len(own) != 1:
        return None
    name, log = own[0].name, own[0].spacing == "log"
    here = leader.shape[name]
    others = np.array([c.shape[name] for c in near])
    others = np.log(others / here) if log else others - here
    apart = np.abs(others[np.abs(others) > 1e-9 * np.abs(others).max()])
    if not len(apart):
        return value

    def gain(off: float) -> float:
        stack, moved = Stack(len(rows.residual)), here * np.exp(off) if log else here + off
        _add_at(stack, rows, leader, {**leader.shape, name: float(moved)})
        return float(stack.log_bayes_factors(whitener, y)[0]) if len(stack) else -np.inf

    return close_in(gain, 0.0, value, 0.5 * float(apart.min()))


def _add_at(stack: Stack, rows: Rows, leader: Candidate, shape: Mapping[str, float]) -> None:
    """Add an effect's candidate at another shape, if it shows anything there."""
    columns = candidate_columns(rows, leader, shape, reference=True)
    if columns is not None:
        stack.add(replace(leader, index=stack.columns.add(columns), shape=shape))
