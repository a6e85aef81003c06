"""What a search has accepted so far, and what that puts in the mean and takes from the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.effects import get_effect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.rows.rows import Rows
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray

UNLIKE = 0.1
"""Part of what a low-pass takes away that one of another make would not."""


@dataclass(frozen=True, eq=False)
class Accepted:
    """A hypothesis that was accepted.

    ``values`` are its coefficients in the units of the effect's parameters, ``in_model`` whether
    the rows' residual already has them taken out.
    """

    candidate: Candidate
    columns: FloatArray
    typical: FloatArray
    values: FloatArray
    in_model: bool
    e_value: float
    posterior: Mapping[str, float] = field(default_factory=dict)


def accept(stack: Stack, chosen: Candidate, e_value: float) -> Accepted:
    """Return a candidate as a finding, not yet fitted."""
    columns = stack.of(chosen)
    typical = np.ones(columns.shape[1])
    if chosen.physical:
        sizes = {p.name: p.typical for p in get_effect(chosen.name).parameters}
        typical = np.array([sizes[n] for n in chosen.parameters])
    return Accepted(chosen, columns, typical, np.zeros(columns.shape[1]), False, e_value)


def joined(
    rows: Rows, accepted: list[Accepted], new: Accepted, *, reference: bool
) -> list[Accepted]:
    """Return the findings with a new one; other parameters of one effect are one finding.

    But for what is there or not: how strong it is is in a shape, and each channel has its own.
    """
    old = next((a for a in accepted if a.candidate.name == new.candidate.name), None)
    if old is None or not lasting(new.candidate) or new.candidate.present:
        return [*accepted, new]
    effect = get_effect(new.candidate.name)
    shape = {**new.candidate.shape, **old.candidate.shape}
    both = {*old.candidate.parameters, *new.candidate.parameters}
    chosen = [p for p in effect.parameters if p.name in both]
    names = tuple(p.name for p in chosen)
    candidate = replace(with_parameters(old.candidate, names), shape=shape)
    columns = candidate_columns(rows, candidate, shape, reference=reference)
    if columns is None:
        return [*accepted, new]
    values = dict(zip(old.candidate.parameters, old.values, strict=True))
    merged = replace(
        old,
        candidate=candidate,
        columns=columns,
        typical=np.array([p.typical for p in chosen]),
        values=np.array([values.get(n, 0.0) for n in names]),
    )
    return [*(a for a in accepted if a is not old), merged]


def with_parameters(candidate: Candidate, names: tuple[str, ...]) -> Candidate:
    """Return a candidate with these parameters of its effect, on the channels that they touch."""
    parameters = [p for p in get_effect(candidate.name).parameters if p.name in names]
    return replace(
        candidate,
        index=np.arange(len(names)),
        parameters=names,
        channels=tuple(dict.fromkeys(c for p in parameters for c in p.channels)),
    )


def lasting(candidate: Candidate) -> bool:
    """Whether a candidate is physics that a recording has once, and not at each of many moments."""
    return candidate.physical and get_effect(candidate.name).kind != "event"


def again(candidate: Candidate, accepted: Sequence[Accepted]) -> bool:
    """Whether an effect was found already on all that a candidate touches."""
    return lasting(candidate) and any(
        set(candidate.parameters) <= set(a.candidate.parameters)
        for a in accepted
        if a.candidate.name == candidate.name
    )


def fitted(rows: Rows, accepted: list[Accepted] | tuple[Accepted, ...]) -> FloatArray:
    """Return all columns that are always fitted: baseline, nuisances, and what was accepted."""
    return np.hstack((rows.baseline, rows.nuisance, *(a.columns for a in accepted)))


def contrast_noise(rows: Rows, accepted: Sequence[Accepted], *also: Candidate) -> FloatArray:
    """Return the variance of the contrast rows, as it is outside of what is found in windows.

    And beside what is there or not, which is in the mean: the model does not take it up.
    """
    apart = np.zeros(len(rows.residual) - rows.n_dense, bool)
    for item in (*(a.candidate for a in accepted), *also):
        if item.physical or item.interval is None:
            continue
        start, stop = item.interval
        inside = (rows.interval[:, 0] < stop) & (rows.interval[:, 1] > start)
        own = np.isin(rows.channel, [CHANNELS.index(c) for c in item.channels])
        apart |= (inside[rows.segment] & own)[rows.n_dense :]
    beside = [a for a in accepted if a.candidate.present and not a.in_model]
    return contrast_variance(_without(rows, beside, ~apart) if beside else rows, apart=apart)


def _without(rows: Rows, beside: list[Accepted], which: BoolArray) -> Rows:
    """Return the rows without most of some findings in their contrasts, as those marked fit it."""
    weight = (which / np.sqrt(rows.white_diagonal))[:, None]
    mean, left = fitted(rows, beside)[rows.n_dense :], rows.residual[rows.n_dense :]
    size = np.linalg.norm(mean * weight, axis=0)
    mean = mean / np.where(size > 0, size, np.inf)
    fit = np.linalg.lstsq(mean * weight, left * weight[:, 0], rcond=1e-9)[0]
    start = rows.baseline.shape[1] + rows.nuisance.shape[1]
    fit[start:] *= 1.0 - UNLIKE
    return rows.with_residual(np.append(rows.residual[: rows.n_dense], left - mean @ fit))
