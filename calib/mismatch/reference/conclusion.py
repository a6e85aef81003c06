"""What is found beside a truth: the search, and all that samples and alignment have to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from calib.effects import effects, get_effect
from calib.effects.base import Term
from calib.mismatch.findings.diagnosis import (
    Diagnosis,
    Finding,
    Unexplained,
    claimed,
)
from calib.mismatch.hypotheses.places import gathered, joined
from calib.mismatch.reference.carried import OF_GYRO
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.given import told_further, with_given
from calib.mismatch.reference.others import axes_since, told_from_the_other
from calib.mismatch.reference.setupfindings import find_setups
from calib.mismatch.reference.unturned import UNTURNED, with_any_angle
from calib.mismatch.samples.found import Samples
from calib.mismatch.samples.resting import told_once, unsaid
from calib.mismatch.samples.within import is_told, look_beside
from calib.mismatch.search.determined import open_baseline, to_determine
from calib.mismatch.search.estimate import Estimate
from calib.mismatch.search.explain import explain, verdict
from calib.mismatch.search.proof import changes
from calib.mismatch.search.search import Outcome, search
from calib.model import SensorModel
from calib.recording import AXES
from calib.rotation import rotvec_from_mat
from calib.types import FloatArray

NOWHERE = "positions in the reference"
"""What shows those."""

UNPLACED = ("accel_lever_arm", "accel_size_effect", "time_offset")
"""What shows only where it is known what an accelerometer feels while it moves: its place, that of
its axes, and its delay against the gyroscope."""

COMPARED, MOST_OF_IT = "compared", 0.8
"""How much of a recording was compared, where it is less than this share of it."""


def conclude(
    problem: ComparisonProblem,
    seen: Samples,
    summary: Mapping[str, object],
    *,
    setups: tuple[str, ...],
    clocks: FloatArray,
    noisy: tuple[Unexplained, ...],
    skip: tuple[str, ...],
    missing: tuple[str, ...],
    another: bool = False,
) -> Diagnosis:
    """Search, explain, and report alignments among ``setups`` as findings.

    ``clocks`` are the standard errors of the clocks' offset (s) and pace, (2,), ``another`` is
    whether the truth is another IMU, and ``noisy`` what the samples at rest show.
    """
    skip = _skipped(problem, skip)
    outcome, model = _in_samples(search(problem, skip=skip), problem.setup.model, problem.thin)
    fit, any_angle = _free_to_turn(problem, outcome)
    further = _further(problem, outcome, fit)
    findings, unexplained, known = explain(outcome, fit, names=problem.names, further=further)
    findings = [with_given(f, problem.given) for f in findings]
    # The fit's last small step is still to be taken from where the rows stand.
    model = model.with_terms_moved({name: float(fit.step[k]) for name, k in further.items()})
    if any_angle:
        # What an arm is then nobody can tell, nor what it is worth.
        arm = get_effect("accel_lever_arm").follows
        unexplained = [u for u in unexplained if not u.follows.startswith(arm)]
    axes = 0.0
    if another:
        spread = problem.loose[-len(problem.setup.errors) :]
        findings, others = told_from_the_other(findings, problem.setup.errors, spread)
        missing += others
        # How another IMU is turned nobody knows better than its gyroscope's own axes.
        axes = float(np.sqrt(np.mean(np.square(spread[len(AXES) : OF_GYRO]))))
    found = find_setups(outcome, fit, problem, setups, clocks, axes=axes)
    begin = outcome.rows.interval[:, 0]
    findings = [f for f in findings if not any(_the_same(f, g, begin) for g in seen.findings)]
    findings = [*seen.findings, *found, *findings]
    noisy = (*noisy, *_beside(problem, outcome, another=another))
    unexplained = _all_unexplained(problem, seen, findings, unexplained, noisy)
    names, covariance = _of_model((*problem.names, *further), findings, *known)
    if another:
        moved = {name: float(problem.moved[k] + fit.step[k]) for name, k in further.items()}
        covariance, others = axes_since(moved, names, covariance, spread)
        missing += others
    open_ = open_baseline(problem.names, fit)
    if problem.judged is not None:
        # What it lacks for one sensor is no lack for the other.
        poses = [n for n in open_ if n.startswith("accel.")]
        open_ = [n for n in open_ if n not in poses]
        missing += _unplaced(problem, poses)
    if open_:
        missing += (to_determine(open_),)
    if any_angle:
        missing += (UNTURNED,)
    change, likelihood = changes(outcome)
    return Diagnosis(
        verdict=verdict(tuple(findings), tuple(unexplained), able=not open_),
        findings=tuple(findings),
        unexplained=tuple(unexplained),
        missing=missing,
        hidden=_hidden(problem, outcome, skip),
        changes=change,
        log_likelihood=likelihood,
        model=claimed(model, problem.given, findings),
        names=names,
        covariance=covariance,
        undetermined=tuple(n for n in (*problem.names, *further) if n not in names),
        summary={**summary, **_compared(problem, cast(float, summary["duration"]))},
    )


def _skipped(problem: ComparisonProblem, skip: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names that are not looked for: among others those that are always fitted."""
    if problem.judged is not None:
        skip += UNPLACED
    turned = problem.turned or problem.own_axes
    skip += ("clock_scale", *(("reference_misalignment",) if turned else ()))
    return skip + (("gyro_misalignment",) if problem.full_gyro else ())


def _free_to_turn(problem: ComparisonProblem, outcome: Outcome) -> tuple[Estimate, bool]:
    """Return the fit, and whether the sensor may be turned by any angle about one axis."""
    fit = outcome.fit(reference=True)
    if not problem.turned:
        return fit, False
    p, number = len(problem.names), len(problem.alignments)
    alone = partial(problem.told_by_noise, outcome.rows)
    return with_any_angle(fit, slice(p + number - 3, p + number), alone)


def _beside(
    problem: ComparisonProblem, outcome: Outcome, *, another: bool
) -> tuple[Unexplained, ...]:
    """Return what the truth itself does, and what samples show beside it."""
    found = [a.candidate for a in outcome.accepted if a.candidate.present]
    filters = tuple(Term(c.name, {**dict.fromkeys(c.parameters, 1.0), **c.shape}) for c in found)
    slips, left = problem.slips(filters), problem.left(filters)
    if left is None:
        return tuple(slips)
    return (*slips, *look_beside(*left, exact=not problem.noisy and not another))


def _all_unexplained(
    problem: ComparisonProblem,
    seen: Samples,
    findings: Sequence[Finding],
    unexplained: Sequence[Unexplained],
    noisy: tuple[Unexplained, ...],
) -> list[Unexplained]:
    """Return what is unexplained: of samples, of rows, and of noise that nothing else is."""
    said, noisy = told_once(seen.unexplained, noisy)
    noisy = unsaid(noisy, findings, said, problem.given)
    noisy = tuple(item for item in noisy if not is_told(item, [*said, *unexplained]))
    return [*said, *gathered(joined([*unexplained, *noisy]))]


def _further(problem: ComparisonProblem, outcome: Outcome, fit: Estimate) -> dict[str, int]:
    """Return which coefficients are a given model's further terms that motion tells, by name."""
    sigma = np.sqrt(np.diag(fit.covariance))
    found = {a.candidate.name for a in outcome.accepted}
    told = told_further(problem.further, problem.first_further, sigma)
    return {name: k for name, k in told.items() if name.split(".")[0] not in found}


def _of_model(
    own: Sequence[str],
    findings: Sequence[Finding],
    known: tuple[str, ...],
    covariance: FloatArray,
) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and covariance of those parameters that are known and said.

    Those of the model's ``own``, and of findings.
    """
    slugs = {f.effect for f in findings}
    keep = [i for i, n in enumerate(known) if n in own or n.split(".")[0] in slugs]
    return tuple(known[i] for i in keep), covariance[np.ix_(keep, keep)]


def _hidden(problem: ComparisonProblem, outcome: Outcome, skip: tuple[str, ...]) -> dict[str, str]:
    """Return the effects that nothing here would show, with what each needs."""
    always = {*skip, *(f.name.split(".")[0] for f in problem.further)}
    out = {
        slug: effect.needs
        for slug, effect in effects().items()
        if slug not in outcome.tried and effect.kind == "sensor" and slug not in always
    }
    return out | (dict.fromkeys(UNPLACED, NOWHERE) if problem.judged is not None else {})


def _compared(problem: ComparisonProblem, duration: float) -> dict[str, object]:
    """Return what a summary says of the comparison with a recording of so many seconds."""
    alignment, errors = problem.setup.alignment, problem.setup.errors
    common, (first, last) = len(problem.time) * problem.interval, problem.time[[0, -1]].tolist()
    part = {COMPARED: {"seconds": common, "from": first, "to": last}}
    return {
        **(part if common < MOST_OF_IT * duration else {}),
        "compared_samples": len(problem.time),
        "alignment": {
            "offset": alignment.offset,
            "stretch": alignment.stretch,
            "middle": alignment.middle,
            "rotation": rotvec_from_mat(problem.setup.mat_sr).tolist(),
            "correlation": alignment.correlation,
            "reference_gyro": errors[:OF_GYRO].tolist(),
            "reference_accel": errors[OF_GYRO:].tolist(),
        },
    }


def _in_samples(outcome: Outcome, model: SensorModel, thin: int) -> tuple[Outcome, SensorModel]:
    """Return findings and model with numbers of samples as the recording counts them.

    They were counted in the samples that are compared, every `thin`-th.
    """
    counted = {
        slug: [p.name for p in effect.parameters if p.unit == "samples"]
        for slug, effect in effects().items()
    }
    accepted = tuple(
        replace(a, columns=a.columns / thin) if counted.get(a.candidate.name) else a
        for a in outcome.accepted
    )
    terms = tuple(
        replace(
            t,
            parameters={
                k: v * (thin if k in counted[t.effect] else 1) for k, v in t.parameters.items()
            },
        )
        for t in model.terms
    )
    return replace(outcome, accepted=accepted), replace(model, terms=terms)


def _the_same(finding: Finding, seen: Finding, begin: FloatArray) -> bool:
    """Whether the samples themselves show an event, at a moment that is exact there.

    By rows it is at the same one within its error; or, as in a rest nothing but its ends tells when
    it was, in the same rest or turn, or in the next one. They ``begin`` at these times, (s,).
    """
    if finding.effect != seen.effect or "moment" not in finding.parameters:
        return False
    own, exact = finding.parameters["moment"], seen.parameters["moment"]
    # What is anywhere in a rest is at most the square root of 12 of its standard errors off.
    if abs(own.value - exact.value) <= np.sqrt(12.0) * (own.sigma or 0.0):
        return True
    first, second = np.searchsorted(begin, [own.value, exact.value], side="right")
    return bool(abs(first - second) <= 1)


def _unplaced(problem: ComparisonProblem, poses: list[str]) -> tuple[str, ...]:
    """Return what is lacked where positions are, and rests for the parameters of `poses`."""
    assert problem.judged is not None
    rest, whole = (float(n) * problem.interval for n in (problem.judged.sum(), len(problem.time)))
    how = f"only at rest ({rest:.3g} s of {whole:.3g} s)" if rest else "not at all: nothing rests"
    positions = (
        f"{NOWHERE}: without them the accelerometer is judged {how}, and {', '.join(UNPLACED[:2])} "
        "and its delay cannot be told; if the body turned about a fixed point, as on a table, say "
        "so with --fixed-point"
    )
    if not (rest and poses):
        return (positions,)
    return positions, f"rests in poses that determine {', '.join(poses)}"
