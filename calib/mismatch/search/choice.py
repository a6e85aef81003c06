"""Which explanation is taken: physics against rivals, and neither for what was found already."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, logsumexp

from calib.effects import get_effect
from calib.mismatch.hypotheses.candidates import MOVING, Candidate
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.noise import Whitener, range_basis
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, accept, again
from calib.mismatch.search.estimate import pseudo_inverse
from calib.mismatch.search.ranking import CLAIM, PLAIN, Ranking, rank
from calib.mismatch.search.witness import witnessed
from calib.types import FloatArray

FIRST = float(np.log(2.0))
"""Log odds by which rivals must lead before what physics explains nearly as well is unexplained, if
physics alone reaches the claim. Either way both are said. A technician who is told a name can
check it."""

SURE = 3.0
"""Standard errors by which an effect must be beyond what is physical to be none."""

LEAST = float(log_ndtr(-SURE) - log_ndtr(0.0))
"""Log probability of what is that far beyond."""


SAME = 0.9
"""Share of what an effect does to the rows that a smooth function of what a rival follows makes of
it, from which both follow the same."""


class Choice(NamedTuple):
    """The explanation that is taken, and the log e-value that anything is left.

    That counts only what may be the cause: what was passed over says nothing of how rare it is.
    ``behind`` is physics that is plain, each with by how much less log evidence it has than the
    rivals: the best on the channels of the candidate, and the best on others.
    """

    candidate: Candidate
    worth: float
    behind: tuple[tuple[Candidate, float], ...] = ()


def choose(
    rows: Rows,
    ranking: Ranking,
    accepted: list[Accepted],
    *,
    passed: frozenset[str] = frozenset(),
) -> Choice | None:
    """Return what explains most: physics, unless the rivals together are more probable.

    An event where something is unexplained already is part of that, and gets no name of its own;
    nor does what explains less than such an event, on a channel that both show on, or what follows
    the same as something unexplained on the same channel. What an effect leaves that was found
    already is no second finding of it. What no channel of it shows is another cause, and lends it
    no weight. Nor does a turn that samples do not resolve, of what it alone shows. Groups that are
    ``passed`` over were tried, and are none.
    """
    best = ranking.best
    whitener = ranking.whitener
    y = whitener.project(rows.residual)
    every = {
        g: v + possible(ranking.stack, best[g], whitener, y)
        for g, v in witnessed(rows, ranking, whitener, y).items()
        if g not in passed and not again(best[g], accepted)
    }
    parts = {g: v for g, v in every.items() if is_part(rows, best[g], accepted)}
    groups = {
        g: v
        for g, v in every.items()
        if g not in parts and not (best[g].physical and _left_of(best, g, v, parts))
    }
    # With what follows the same as something unexplained goes what explains less of that channel.
    same = [g for g in groups if _follows(ranking, best[g], accepted)]
    part = [(best[g].channels, groups[g]) for g in same]
    groups = {
        g: v
        for g, v in groups.items()
        if v > max((most for own, most in part if own == best[g].channels), default=-np.inf)
    }
    ranking = replace(ranking, groups=groups)
    if not ranking.claims:
        return None
    chosen = _most_probable(rows, ranking, groups, accepted)
    if chosen is None:
        return None
    alike = {g: v for g, v in groups.items() if set(best[g].channels) & set(chosen.channels)}
    if logsumexp(list(alike.values())) < np.log(CLAIM):
        return None
    if chosen.physical:
        return Choice(chosen, ranking.total)
    rivals = float(logsumexp([v for g, v in groups.items() if not best[g].physical]))
    # Rests that may lean as they like close any turn: the cause can be on other channels as well.
    plain = {g for g, v in groups.items() if best[g].physical and v > PLAIN}
    sides = (plain & set(alike), plain - set(alike))
    behind = [max(some, key=groups.__getitem__) for some in sides if some]
    return Choice(chosen, ranking.total, tuple((best[g], rivals - groups[g]) for g in behind))


def _left_of(
    best: Mapping[str, Candidate], group: str, value: float, parts: Mapping[str, float]
) -> bool:
    """Whether what is part of something unexplained explains more of a channel than a group."""
    own = set(best[group].channels)
    return any(value < more and own & set(best[g].channels) for g, more in parts.items())


def _most_probable(
    rows: Rows, ranking: Ranking, groups: Mapping[str, float], accepted: list[Accepted]
) -> Candidate | None:
    """Return the best of the more probable side, physics or rivals, by what the groups count."""
    best = ranking.best
    physical = [g for g in groups if best[g].physical]
    rival = [g for g in groups if not best[g].physical]
    top = max(physical, key=lambda g: groups[g], default=None)
    other = max(rival, key=lambda g: groups[g], default=None)
    if top is None:
        return None if other is None else best[other]
    if other is None:
        return best[top]
    for_physics = logsumexp([groups[g] for g in physical])
    for_rivals = logsumexp([groups[g] for g in rival])
    ahead = for_physics - for_rivals
    if ahead >= 0 or (ahead >= -FIRST and for_physics >= np.log(CLAIM)):
        return best[top]
    # Two causes at once can look like one smooth rival: let physics try twice. What it leaves the
    # first time must not follow a rival either.
    if groups[top] > np.log(CLAIM):

        def beside(first: Candidate) -> Ranking:
            taken = accept(ranking.stack, first, 1.0)
            levels = ranking.levels_with(first)
            return rank(rows, ranking.stack, [*accepted, taken], levels, every=ranking.every)

        second = beside(best[top])
        left = {g: v for g, v in second.groups.items() if second.best[g].physical}
        also = max(left, key=lambda g: left[g], default=None)
        beyond = max((v for g, v in second.groups.items() if g not in left), default=-np.inf)
        if (
            also is not None
            and groups[top] + left[also] > for_rivals
            and left[also] > max(np.log(CLAIM), beyond)
        ):
            # A cause that is there beside the rival as well speaks for neither.
            apart = max(beside(best[other]).groups.get(also, 0.0), 0.0)
            if groups[top] + left[also] > for_rivals + apart:
                return best[top]
    return best[other]


def is_part(rows: Rows, candidate: Candidate, accepted: list[Accepted]) -> bool:
    """Whether a candidate is part of what was accepted, and no second cause.

    So is an event in, or at the edge of, what is unexplained in one of its channels, and a bias
    that moves there; and what is left in the turn of an event that was linearised at its moment.
    """
    event = candidate.physical and get_effect(candidate.name).kind == "event"
    moment = candidate.shape.get("moment")
    if candidate.name == MOVING and candidate.interval is not None:
        event, moment = True, 0.5 * (candidate.interval[0] + candidate.shape["until"])
    for a in accepted:
        if not set(a.candidate.channels) & set(candidate.channels):
            continue
        if a.candidate.physical:
            if not a.in_model and "moment" in a.candidate.shape:
                start, stop = _around(rows, a.candidate.shape["moment"])
                first, last = candidate.interval or (moment, moment)
                if first is not None and last is not None and start <= first and last <= stop:
                    return True
            continue
        if not event:
            continue
        if a.candidate.interval is None or moment is None:
            return True
        start, stop = a.candidate.interval
        edge = 0.5 * (stop - start)
        if start - edge <= moment <= stop + edge:
            return True
    return False


def _follows(ranking: Ranking, candidate: Candidate, accepted: list[Accepted]) -> bool:
    """Whether physics of one channel follows what something unexplained does there, throughout.

    A ripple in the direction of gravity is no cubic, and beside it a cubic is left of it.
    """
    names = {
        a.candidate.name
        for a in accepted
        if not a.candidate.physical
        and a.candidate.interval is None
        and a.candidate.channels == candidate.channels
    }
    if not candidate.physical or not names:
        return False
    stack, whitener = ranking.stack, ranking.whitener
    rivals = np.flatnonzero(stack.of_channels(candidate.channels, physical=False)).tolist()
    smooth = [c for i in rivals if (c := stack[i]).name in names and c.mixing is None]
    own = whitener.whiten(stack.of(candidate))
    for rival in smooth:
        basis = range_basis(whitener.whiten(stack.of(rival)))
        if np.square(basis.T @ own).sum() >= SAME * np.square(own).sum():
            return True
    return False


def _around(rows: Rows, moment: float) -> tuple[float, float]:
    """Return the rest or turn that a moment lies in, with those beside it."""
    k = rows.segment_at(moment)
    return float(rows.interval[max(k - 1, 0), 0]), float(rows.interval[: k + 2, 1].max())


def possible(stack: Stack, candidate: Candidate, whitener: Whitener, y: FloatArray) -> float:
    """Return how probable it is that an effect is no larger than any is, at best, as a logarithm.

    What would have to be clearly larger, or smaller than it can be, mimics something else: -inf.
    """
    if not candidate.physical:
        return 0.0
    effect = get_effect(candidate.name)
    least, most = effect.limits(candidate.parameters)
    if not np.isfinite([least, most]).any():
        return 0.0
    columns = whitener.project(stack.of(candidate))
    inverse = pseudo_inverse(columns)
    about = {p.name: p.typical for p in effect.parameters}
    typical = np.array([about[n] for n in candidate.parameters])
    value = typical * (inverse @ y)
    if effect.too_small(value, np.outer(typical, typical) * (inverse @ inverse.T)):
        return -np.inf
    sigma = typical * np.linalg.norm(inverse, axis=1)
    beyond = np.maximum(np.maximum(value - most, least - value), 0.0)
    beyond = np.divide(beyond, sigma, out=np.zeros(len(value)), where=beyond > 0)
    if (beyond > SURE).any():
        return -np.inf
    return float((log_ndtr(-beyond) - log_ndtr(0.0)).sum())
