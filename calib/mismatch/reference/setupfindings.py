"""An alignment of two recordings that is beyond noise, as a finding."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.calibration import Quantity
from calib.effects import get_effect
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.findings.evidence import Evidence, Regressor, gather
from calib.mismatch.findings.heldout import HeldOut, held_out
from calib.mismatch.hypotheses.factors import SCALES, SHARES
from calib.mismatch.hypotheses.families import PHYSICAL, tried_effects
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.estimate import Estimate, solved
from calib.mismatch.search.ranking import CLAIM, chance
from calib.mismatch.search.search import Outcome
from calib.recording import CHANNELS
from calib.rotation import rotvec_from_mat, rotvec_slope
from calib.types import FloatArray, IntArray

_LINEAR = {"time_offset": 0.02, "clock_scale": 1e-4, "reference_misalignment": 0.1}
"""Sizes (SI) up to which an alignment acts in proportion, so that it can be left out again to see
what it is worth on held-out windows."""

SETTLED_FIRST = ("clock_scale", "time_offset", "reference_misalignment")
"""In this order alignments are judged: a delay is that of the first sample, as the clock ran since.
Where the clock ran as the other did, it is what it is at any moment, and best known."""


def find_setups(
    outcome: Outcome,
    fit: Estimate,
    problem: ComparisonProblem,
    setups: tuple[str, ...],
    clocks: FloatArray,
    *,
    axes: float = 0.0,
) -> list[Finding]:
    """Return the alignments that are beyond noise as findings, with the evidence of any other.

    ``clocks`` are the standard errors, (2,), of the offset (s) and the pace of what stamped,
    ``axes`` is that of the directions of the other's axes, rad.
    """
    found = _aligned(problem, fit, clocks, axes)
    slugs = [name.split(".")[0] for name in problem.alignments]
    prior = PHYSICAL / len(tried_effects(reference=True))
    out = {}
    for slug in sorted(set(slugs), key=SETTLED_FIRST.index):
        own = np.array([i for i, s in enumerate(slugs) if s == slug])
        names = [problem.alignments[i].split(".")[1] for i in own]
        sizes = {x.name: x.typical for x in get_effect(slug).parameters}
        value, covariance = found.value[own], found.covariance[np.ix_(own, own)]
        typical = np.array([sizes[n] for n in names])
        e_value = prior * bayes_factor(value, covariance, typical)
        if slug in setups and e_value >= CLAIM:
            out[slug] = _setup(outcome, fit, problem, slug, names, own, value, covariance, e_value)
        elif slug in setups:
            found = found.without(own)
    return [out[slug] for slug in dict.fromkeys(slugs) if slug in out]


class _Aligned(NamedTuple):
    """The parameters of an alignment (n,) as their effects count them, and their covariance."""

    value: FloatArray
    covariance: FloatArray

    def without(self, none: IntArray) -> _Aligned:
        """Return what they are if those at these places are nothing.

        By the regression of the others on them.
        """
        share = np.linalg.solve(self.covariance[np.ix_(none, none)], self.covariance[none]).T
        return _Aligned(
            self.value - share @ self.value[none], self.covariance - share @ self.covariance[none]
        )


def _aligned(
    problem: ComparisonProblem, fit: Estimate, clocks: FloatArray, axes: float
) -> _Aligned:
    """Return what the alignment is by the fit, the delay being that of the first sample.

    Where that is, `clock_scale` counts from: at the middle a clock that runs slow is late by its
    share of half of the recording.
    """
    alignment, turn = problem.setup.alignment, rotvec_from_mat(problem.setup.mat_sr)
    first, p, number = problem.power_on, len(problem.names), len(problem.alignments)
    late = first - float(alignment.times(np.array([first]))[0])
    value = np.array([late, 1.0 / (1.0 + alignment.stretch) - 1.0, *(-turn)])[:number]
    slope = np.eye(5)
    slope[0, 1] = first - alignment.middle
    # Steps turn the frame where it is by now, and what is said is one vector from the start.
    slope[2:, 2:] = rotvec_slope(turn)
    slope = slope[:number, :number]
    covariance = fit.covariance[p : p + number, p : p + number]
    stamped = np.array([*clocks, axes, axes, axes])[:number]
    # The fit's last small step is still to be taken from where the rows stand.
    return _Aligned(
        value + slope @ fit.step[p : p + number],
        slope @ covariance @ slope.T + slope @ np.diag(np.square(stamped)) @ slope.T,
    )


def bayes_factor(value: FloatArray, covariance: FloatArray, typical: FloatArray) -> float:
    """Return the evidence that an estimate is not zero, averaged over `SCALES` of its size."""
    logs = []
    for scale in SCALES:
        wide = covariance + np.diag(np.square(scale * typical))
        gain = value @ np.linalg.solve(covariance, value) - value @ np.linalg.solve(wide, value)
        change = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(wide)[1]
        logs.append(0.5 * (gain + change))
    return float(np.exp(min(max(logs), 690.0)) * (SHARES @ np.exp(np.array(logs) - max(logs))))


def _setup(
    outcome: Outcome,
    fit: Estimate,
    problem: ComparisonProblem,
    slug: str,
    names: list[str],
    own: IntArray,
    value: FloatArray,
    covariance: FloatArray,
    e_value: float,
) -> Finding:
    effect, rows = get_effect(slug), outcome.rows
    units = {x.name: x.unit for x in effect.parameters}
    proof: HeldOut | None = None
    evidence: Evidence | None = None
    reason = "without it the two are not aligned, and nothing can be compared"
    if np.abs(value).max() <= _LINEAR[slug]:
        keep = np.ones(rows.nuisance.shape[1], bool)
        keep[own] = False
        nuisance = _from_the_first(rows.nuisance, problem)
        columns = nuisance[:, own]
        without = replace(
            rows,
            residual=rows.residual + columns @ value,
            nuisance=nuisance[:, keep],
            aligned=tuple(n for n, k in zip(rows.aligned, keep, strict=True) if k),
            prior=np.delete(rows.prior, rows.baseline.shape[1] + own, axis=0),
        )
        mean = fitted(without, outcome.accepted)
        reason = ""
        proof = held_out(
            rows,
            mean,
            columns,
            without.residual,
            levels=outcome.levels,
            contrast=outcome.contrast,
            channels=CHANNELS,
        )
        step, *_ = solved(without, outcome.accepted, outcome.levels, outcome.contrast)
        evidence = gather(
            rows,
            effect.follows,
            columns @ value,
            without.residual - mean @ step,
            fit.left,
            regressor=Regressor.of(effect, names, columns, value),
        )
    sigma = np.sqrt(np.diag(covariance))
    return Finding(
        effect=slug,
        title=effect.title,
        kind=effect.kind if slug != "time_offset" else "setup",
        channels=CHANNELS,
        intervals=((float(problem.time[0]), float(problem.time[-1])),),
        regime=effect.follows,
        parameters={
            n: Quantity(float(v), float(s), units[n])
            for n, v, s in zip(names, value, sigma, strict=True)
        },
        p_value=chance(e_value),
        absorbed_by=(),
        held_out=proof,
        held_out_reason=reason,
        rivals=(),
        to_separate="",
        sentence=effect.sentence,
        evidence=evidence,
    )


def _from_the_first(nuisance: FloatArray, problem: ComparisonProblem) -> FloatArray:
    """Return (m, k) columns of nuisances with that of the clock counted from the first sample."""
    out = nuisance.copy()
    out[:, 1] += (problem.setup.alignment.middle - problem.power_on) * nuisance[:, 0]
    return out
