"""An alignment of two recordings that is beyond noise, as a finding."""

from __future__ import annotations

import numpy as np

from calib.calibration import Quantity
from calib.effects import get_effect
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.findings.heldout import HeldOut, held_out
from calib.mismatch.hypotheses.factors import SCALES, SHARES
from calib.mismatch.hypotheses.families import PHYSICAL, tried_effects
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.search.estimate import Estimate
from calib.mismatch.search.ranking import CLAIM, chance
from calib.mismatch.search.search import Outcome
from calib.recording import CHANNELS
from calib.rotation import rotvec_from_mat, rotvec_slope
from calib.types import FloatArray

_LINEAR = {"time_offset": 0.02, "clock_scale": 1e-4, "reference_misalignment": 0.1}
"""Sizes (SI) up to which an alignment acts in proportion, so that it can be left out again to see
what it is worth on held-out windows."""

_STAMPED = {"time_offset": 0, "clock_scale": 1}
"""Alignments that are no better known than the clocks."""


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
    out = []
    alignment, mat = problem.setup.alignment, problem.setup.mat_sr
    p = len(problem.names)
    slugs = [name.split(".")[0] for name in problem.alignments]
    # The fit's last small step is still to be taken from where the rows stand.
    step = fit.step[p : p + len(slugs)]
    turn = rotvec_from_mat(mat)
    value = np.array([-alignment.offset, 1.0 / (1.0 + alignment.stretch) - 1.0, *(-turn)])
    # Steps turn the frame where it is by now, and what is said is one vector from the start.
    slope = np.eye(5)
    slope[2:, 2:] = rotvec_slope(turn)
    slope = slope[: len(slugs), : len(slugs)]
    value = value[: len(slugs)] + slope @ step
    errors = slope @ fit.covariance[p : p + len(slugs), p : p + len(slugs)] @ slope.T
    prior = PHYSICAL / len(tried_effects(reference=True))
    for slug in dict.fromkeys(slugs):
        if slug not in setups:
            continue
        own = np.array([i for i, s in enumerate(slugs) if s == slug])
        names = [problem.alignments[i].split(".")[1] for i in own]
        sizes = {x.name: x.typical for x in get_effect(slug).parameters}
        typical = np.array([sizes[n] for n in names])
        covariance = errors[np.ix_(own, own)]
        if slug in _STAMPED:
            covariance = covariance + clocks[_STAMPED[slug]] ** 2
        if slug == "reference_misalignment":
            covariance = covariance + axes**2 * np.eye(len(own))
        e_value = prior * bayes_factor(value[own], covariance, typical)
        if e_value >= CLAIM:
            out.append(_setup(outcome, problem, slug, names, own, value[own], covariance, e_value))
    return out


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
    problem: ComparisonProblem,
    slug: str,
    names: list[str],
    own: FloatArray,
    value: FloatArray,
    covariance: FloatArray,
    e_value: float,
) -> Finding:
    effect, rows = get_effect(slug), outcome.rows
    units = {x.name: x.unit for x in effect.parameters}
    proof: HeldOut | None = None
    reason = "without it the two are not aligned, and nothing can be compared"
    if np.abs(value).max() <= _LINEAR[slug]:
        keep = np.ones(rows.nuisance.shape[1], bool)
        keep[own] = False
        columns = rows.nuisance[:, own]
        mean = np.hstack(
            (rows.baseline, rows.nuisance[:, keep], *(a.columns for a in outcome.accepted))
        )
        proof, reason = (
            held_out(
                rows,
                mean,
                columns,
                rows.residual + columns @ value,
                levels=outcome.levels,
                contrast=outcome.contrast,
                channels=CHANNELS,
            ),
            "",
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
    )
