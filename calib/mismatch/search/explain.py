"""From the search's outcome to a diagnosis: numbers with standard errors, places, proof, words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import chdtrc, fdtrc

from calib.calibration import Quantity, parameter_unit
from calib.effects import effects, get_effect
from calib.effects.base import Effect
from calib.mismatch.findings.diagnosis import (
    Absorbed,
    Change,
    Finding,
    Interval,
    Rival,
    Unexplained,
    Verdict,
)
from calib.mismatch.findings.evidence import TIME, gather
from calib.mismatch.findings.heldout import HeldOut, LeftOut, held_out, leave_out, pose_levels
from calib.mismatch.hypotheses.families import is_moment
from calib.mismatch.hypotheses.places import joined
from calib.mismatch.hypotheses.rivals import FROM_START, SIGN
from calib.mismatch.hypotheses.slipped import angle_of
from calib.mismatch.hypotheses.windows import THROUGHOUT, touched
from calib.mismatch.noise.noise import make_whitener
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import UNLIKE, Accepted, fitted
from calib.mismatch.search.counts import counted, is_whole
from calib.mismatch.search.estimate import Estimate, pseudo_inverse, unique
from calib.mismatch.search.joint import scaled
from calib.mismatch.search.partly import IN_A_PART, acting_part
from calib.mismatch.search.put_down import WORDS, put_down
from calib.mismatch.search.ranking import chance
from calib.mismatch.search.returned import THERE, returned
from calib.mismatch.search.search import BEATEN, SHOWN, TIE, TWIN, Outcome
from calib.mismatch.search.twins import HEADING, too_fast
from calib.recording import CHANNELS, TRIADS
from calib.types import BoolArray, FloatArray

UNSURE = 0.05
"""P-value, all looks counted, above which a finding is not told from how windows scatter."""

LIKELY = 0.05
"""How rarely windows may scatter as they do by chance, for the noise that is assumed to stand."""

SOMETHING = 1e-3
"""The same, were the windows many, up to which there is something in the few that tell."""

FEW_POSES = float(np.log(100.0))
"""Held-out log-likelihood that a name must gain where poses are too few for one to be left out."""


def explain(
    outcome: Outcome,
    fit: Estimate,
    *,
    names: tuple[str, ...],
    further: Mapping[str, int] | None = None,
) -> tuple[list[Finding], list[Unexplained], tuple[tuple[str, ...], FloatArray]]:
    """Return findings, what is unexplained, and names and covariance of the model's parameters.

    The first coefficients are those of ``names``; ``further`` are others of a given model. What
    nobody can tell of these is not among the names that are returned.
    """
    rows, accepted = outcome.rows, outcome.accepted
    findings: list[Finding] = []
    unexplained: list[Unexplained] = []
    model = [*zip(names, range(len(names)), strict=False), *(further or {}).items()]
    known = [name for name, k in model if fit.determined[k]]
    index = [k for _, k in model if fit.determined[k]]
    shapes: list[tuple[int, str]] = []
    of_poses: list[Unexplained] = []
    again, first_rests = returned(fit, accepted), put_down(accepted)
    of_filters = _left_by_filters(outcome, fit)

    @cache
    def after() -> LeftOut:
        mean, levels, contrast = fitted(rows, accepted), outcome.levels, outcome.contrast
        return leave_out(rows, mean, rows.residual, levels=levels, contrast=contrast)

    for i, a in enumerate(accepted):
        rivals = _rivals(a)
        if i in again:
            left = _unexplained(outcome, fit, i, ())
            unexplained.append(replace(left, intervals=(again[i],), follows=THERE))
            continue
        heat = a.candidate.name.replace("_warm_up", "_bias_temperature")
        if heat != a.candidate.name and heat not in outcome.tried:
            # What warms up does so in time; without a thermometer, or with one that is stuck,
            # nobody can tell which it follows.
            rivals = (Rival(heat, 1.0), *rivals)
        if i in first_rests or i in of_filters:
            continue
        if not a.candidate.physical:
            unexplained.append(_unexplained(outcome, fit, i, rivals))
            continue
        part = slice(fit.at[i], fit.at[i + 1])
        values = fit.step[part] * a.typical
        sigma = np.sqrt(np.diag(fit.covariance)[part]) * a.typical
        effect = get_effect(a.candidate.name)
        if effect.kind != "setup" and _is_taken_over(fit, accepted, i):
            continue
        part_of_it = None
        if not rows.clustered:
            part_of_it = acting_part(
                _judging(outcome, i), accepted, i, outcome.levels, outcome.contrast
            )
        if part_of_it is not None:
            left = _unexplained(outcome, fit, i, (Rival(effect.slug, 1.0 / part_of_it.odds),))
            follows = f"{effect.follows}, {IN_A_PART}"
            unexplained.append(replace(left, intervals=(part_of_it.interval,), follows=follows))
            continue
        parameters = {
            n: Quantity(float(v), float(s), parameter_unit(f"{effect.slug}.{n}"))
            for n, v, s in zip(a.candidate.parameters, values, sigma, strict=True)
        }
        if a.candidate.present:
            (name,) = a.candidate.parameters
            if not 0.5 < parameters[name].value < 1.5:
                # It is there or not: what fits by half, or the other way round, is something else.
                left = _unexplained(outcome, fit, i, rivals)
                unexplained.append(replace(left, follows=effect.follows))
                continue
            parameters[name] = Quantity(1.0, None, parameters[name].unit)
        for item in effect.shape:
            if item.name not in a.candidate.shape:
                continue
            here, spread = a.candidate.shape[item.name], None
            if item.spacing == "log" or is_moment(item):
                spread = fit.shapes[i, item.name]
            parameters[item.name] = Quantity(float(here), spread, item.unit)
        sentence = effect.sentence
        if fit.forms.get(i, 0.0) > 1.0 - TIE:
            sentence = f"{sentence} {effect.in_words(a.candidate.shape)}".rstrip()
        if i in first_rests.values():
            sentence = f"{sentence} {WORDS}"
        rivals, more = too_fast(effect, parameters, rivals)
        sentence = f"{sentence} {more}".rstrip()
        absorbed, proof, before = _proof(outcome, fit, i, names, after)
        predicted = a.columns @ fit.step[part]
        if _only_levels(outcome, i, proof):
            of_poses.append(_unexplained(outcome, fit, i, ()))
            continue
        reason = ""
        if effect.kind == "event" and proof.gain <= 0:
            reason = "it happened once: no other pose or turn shows it"
        useless = proof.gain <= 0 or proof.after >= proof.before
        few, any_number = _of_windows(fit, i, a, looks=len(outcome.tried))
        p_value = max(chance(a.e_value), few)
        # Samples come whole: a part of one is something else that happened in this turn.
        broken = any(q.unit == "samples" and not is_whole(q) for q in parameters.values())
        if broken:
            where = (_segment(rows, a.candidate.shape["moment"]),)
            left = _unexplained(outcome, fit, i, rivals)
            unexplained.append(replace(left, intervals=where, follows="this one turn"))
            continue
        parameters = {n: counted(q) if q.unit == "samples" else q for n, q in parameters.items()}
        if useless and effect.kind != "event":
            unexplained.append(
                replace(
                    _unexplained(outcome, fit, i, rivals),
                    follows=f"{effect.follows}, but not on held-out data",
                )
            )
            continue
        if few > UNSURE and any_number > SOMETHING:
            continue
        if few > UNSURE:
            left = _unexplained(outcome, fit, i, rivals)
            unexplained.append(replace(left, follows=f"{effect.follows}, but in few windows only"))
            continue
        findings.append(
            Finding(
                effect=effect.slug,
                title=effect.title,
                kind=effect.kind,
                channels=_channels(effect, parameters),
                intervals=_intervals(rows, a),
                regime=effect.follows,
                parameters=parameters,
                p_value=p_value,
                absorbed_by=absorbed,
                held_out=None if reason else proof,
                held_out_reason=reason,
                rivals=rivals,
                to_separate=to_separate(effect, rivals),
                sentence=sentence,
                evidence=gather(rows, effect.follows, predicted, before, fit.left),
            )
        )
        if effect.kind == "sensor":
            if not a.candidate.present:
                known += [f"{effect.slug}.{n}" for n in a.candidate.parameters]
                index += list(range(part.start, part.stop))
            shapes += [key for key in fit.beside if key[0] == i]
    known += [f"{accepted[i].candidate.name}.{name}" for i, name in shapes]
    index += [len(fit.step) + k for k in range(len(shapes))]
    scale = np.ones(len(fit.step) + len(shapes))
    for i, a in enumerate(accepted):
        scale[fit.at[i] : fit.at[i + 1]] = a.typical
    covariance = (fit.joint(shapes) * np.outer(scale, scale))[np.ix_(index, index)]
    unexplained += _of_poses(of_poses)
    return findings, joined(unexplained), (tuple(known), covariance)


def _is_taken_over(fit: Estimate, accepted: Sequence[Accepted], which: int) -> bool:
    """Whether nothing is left of an effect beside what was found later on its channels, unnamed.

    What wanders, or follows where the sensor points, looks like a step at first.
    """
    own = accepted[which].candidate
    later = (a.candidate for a in accepted[which + 1 :] if not a.candidate.physical)
    if own.present or not any(set(c.channels) & set(own.channels) for c in later):
        return False
    part = slice(fit.at[which], fit.at[which + 1])
    step, covariance = fit.step[part], fit.covariance[part, part]
    return float(chdtrc(len(step), step @ np.linalg.pinv(covariance) @ step)) > UNSURE


def _left_by_filters(outcome: Outcome, fit: Estimate) -> set[int]:
    """Return the findings that are what a filter of another make leaves of its effect.

    No filter is exactly of the forms that are tried. What another form or cut-off would explain
    better is that of one that was found first (or later, if it is better by far), and so is what
    another explains nearly as well, if it is smaller than what filters are unlike by.
    """
    rows, accepted = outcome.rows, outcome.accepted
    filters = [i for i, a in enumerate(accepted) if a.candidate.present]
    out: set[int] = set()
    if not filters or len(accepted) < 2:
        return out
    whitener = make_whitener(rows, outcome.levels, outcome.contrast, rows.baseline[:, :0])
    parts = [a.columns @ fit.step[fit.at[i] : fit.at[i + 1]] for i, a in enumerate(accepted)]
    power = np.square(whitener.whiten(np.stack(parts, axis=1))).sum(axis=0)
    for i, a in enumerate(accepted):
        own = a.posterior.get(a.candidate.group, 0.0)
        for k in filters:
            b = accepted[k]
            other = a.posterior.get(b.candidate.group, 0.0)
            if b.candidate.group == a.candidate.group or (k > i and other < BEATEN * own):
                continue
            if other > own or (other > TIE * own and power[i] < UNLIKE**2 * power[k]):
                out.add(i)
    return out


def _of_windows(fit: Estimate, which: int, a: Accepted, *, looks: int) -> tuple[float, float]:
    """Return how rarely windows that scatter as they do give such coefficients, all looks counted.

    Few windows tell by Snedecor's F, where they scatter by more than the noise that is assumed
    lets them; beside it what chi-squared says, as if they were many. Both are 0 where no windows
    are needed to know the noise, and of an effect with a shape, whose size is that of a mixture.
    """
    if fit.windows is None or a.candidate.shape or a.candidate.present:
        return 0.0, 0.0
    part = slice(fit.at[which], fit.at[which + 1])
    step, covariance = fit.step[part], fit.covariance[part, part]
    square = float(step @ np.linalg.pinv(covariance) @ step)
    share = np.square(step) / np.maximum(np.diag(covariance), np.finfo(float).tiny)
    share /= max(share.sum(), np.finfo(float).tiny)
    count = float(share @ fit.windows.count[part])
    more = float(share @ np.square(fit.windows.wider[part]))
    many = looks * float(chdtrc(len(step), square))
    if chdtrc(count, count * more) > LIKELY:
        return many, many
    return looks * float(fdtrc(len(step), count, square / len(step))), many


def _only_levels(outcome: Outcome, which: int, proof: HeldOut) -> bool:
    """Whether a finding's worth is gone beside free levels of the few poses there are."""
    own = outcome.accepted[which]
    levels = pose_levels(outcome.rows, own.candidate.channels)
    if not levels.shape[1]:
        return False
    others = fitted(outcome.rows, _others(outcome, which))
    beside = held_out(
        outcome.rows,
        np.hstack((others, levels)),
        own.columns,
        outcome.rows.residual,
        levels=outcome.levels,
        contrast=outcome.contrast,
        channels=own.candidate.channels,
    )
    return beside.gain < FEW_POSES <= proof.gain


def _of_poses(items: list[Unexplained]) -> list[Unexplained]:
    """Return what differs between the few poses there are, one item a triad."""
    out = []
    for triad in TRIADS:
        own = [u for u in items if u.channels[0].startswith(triad)]
        if own:
            channels = {c for u in own for c in u.channels}
            first = min(own, key=lambda u: u.p_value)
            follows = "the pose: too few of them to tell by what"
            ordered = tuple(c for c in CHANNELS if c in channels)
            out.append(replace(first, channels=ordered, follows=follows))
    return out


def _rivals(a: Accepted) -> tuple[Rival, ...]:
    # Of what has come to be less than is said, rivals are so much more probable, at least.
    own = max(a.posterior.get(a.candidate.group, SHOWN), SHOWN)
    found = [
        Rival(name, value / own)
        for name, value in a.posterior.items()
        if name != a.candidate.group and value > (TWIN if name in effects() else TIE)
    ]
    return tuple(sorted(found, key=lambda r: -r.odds))


def _unexplained(
    outcome: Outcome, fit: Estimate, which: int, rivals: tuple[Rival, ...]
) -> Unexplained:
    rows, a = outcome.rows, outcome.accepted[which]
    c = a.candidate
    whole = (float(rows.interval[0, 0]), float(rows.interval[-1, 1]))
    angle = angle_of(c)
    follows = get_effect(c.name).follows if c.physical else c.name
    in_time = c.interval is not None or TIME in follows or follows in (THROUGHOUT, FROM_START)
    predicted = a.columns @ fit.step[fit.at[which] : fit.at[which + 1]]
    before, x = _fit_without(outcome, which)[0], TIME if in_time else follows
    seen = gather(rows, x, predicted, before, fit.left, on=touched(c))
    at_rest = seen is not None and any(s.channel in CHANNELS for s in seen.series[:1])
    return Unexplained(
        channels=touched(c),
        intervals=(c.interval or whole,),
        follows=c.name if angle is None else f"{c.name}, by {np.degrees(angle):.2g}°",
        p_value=chance(a.e_value),
        rivals=rivals,
        evidence=seen,
        size=_at_rest(rows, before - fit.left, touched(c)) if at_rest else None,
    )


def _at_rest(rows: Rows, seen: FloatArray, channels: tuple[str, ...]) -> Quantity | None:
    """Return the most that is seen of something in a mean at rest, of its first triad, if any."""
    triad = CHANNELS.index(channels[0]) // 3
    own = (rows.kind == Kind.MEAN) & (rows.channel // 3 == triad)
    most = float(np.abs(seen[own]).max(initial=0.0))
    return Quantity(most, None, ("m/s²", "rad/s")[triad]) if most > 0 else None


def _channels(effect: Effect, parameters: Mapping[str, Quantity]) -> tuple[str, ...]:
    """Return the channels that a significant parameter touches."""
    found = set()
    for p in effect.parameters:
        q = parameters.get(p.name)
        if q is not None and (q.sigma is None or abs(q.value) > 2 * q.sigma):
            found |= set(p.channels)
    if not found:
        found = {c for p in effect.parameters if p.name in parameters for c in p.channels}
    return tuple(c for c in CHANNELS if c in found)


def _intervals(rows: Rows, a: Accepted) -> tuple[Interval, ...]:
    start, stop = float(rows.interval[0, 0]), float(rows.interval[-1, 1])
    effect = get_effect(a.candidate.name)
    if effect.kind == "event":
        for item in effect.shape:
            if item.unit == "s" and item.low is None:
                start = a.candidate.shape[item.name]
    lost = any(p.unit == "samples" for p in effect.parameters)
    if lost and not rows.aligned:
        # By itself a recording shows it in one turn alone; beside a truth all that follows is late.
        return (_segment(rows, start),)
    return ((start, stop),)


def _segment(rows: Rows, moment: float) -> Interval:
    """Return the rest or turn that a moment lies in."""
    start, stop = rows.interval[rows.segment_at(moment)].tolist()
    return start, stop


def _proof(
    outcome: Outcome,
    fit: Estimate,
    which: int,
    names: tuple[str, ...],
    after: Callable[[], LeftOut],
) -> tuple[tuple[Absorbed, ...], HeldOut, FloatArray]:
    """Return what had absorbed a finding, its held-out worth, and the residuals without it.

    ``after`` is what the fit of all findings says of blocks that are left out of it.
    """
    own, rows = outcome.accepted[which], _judging(outcome, which)
    mean = fitted(rows, _others(outcome, which))
    left, without, determined = _fit_without(outcome, which)
    sigma = np.sqrt(np.diag(fit.covariance))
    absorbed = []
    for j, name in enumerate(names):
        shift = float(without[j] - fit.step[j])
        if determined[j] and sigma[j] > 0 and abs(shift) > sigma[j]:
            absorbed.append(Absorbed(name, shift, parameter_unit(name), abs(shift) / sigma[j]))
    absorbed.sort(key=lambda item: -item.standard_errors)
    proof = held_out(
        rows,
        mean,
        own.columns,
        rows.residual,
        levels=outcome.levels,
        contrast=outcome.contrast,
        channels=own.candidate.channels,
        after=after() if rows is outcome.rows else None,
    )
    return tuple(absorbed[:8]), proof, left


def _judging(outcome: Outcome, which: int) -> Rows:
    """Return the rows that judge one finding."""
    own = outcome.accepted[which].candidate
    return outcome.rows.judging(own.name) if own.physical else outcome.rows


def _others(outcome: Outcome, which: int) -> list[Accepted]:
    return [a for i, a in enumerate(outcome.accepted) if i != which]


def _fit_without(outcome: Outcome, which: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return what is left without one finding, the coefficients, and which are determined."""
    rows = _judging(outcome, which)
    unit, scale = scaled(fitted(rows, _others(outcome, which)))
    whitener = make_whitener(rows, outcome.levels, outcome.contrast, unit[:, :0])
    without, determined = _least_squares(whitener.whiten(unit), whitener.whiten(rows.residual))
    return rows.residual - unit @ without, without / scale, determined


def _least_squares(design: FloatArray, y: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the shortest solution, and which of its elements are the same in all of them."""
    inverse = pseudo_inverse(design)
    return inverse @ y, unique(inverse, design)


_CLOCK_LIKE = ("warm_up", "bias_step")
_HEAT_LIKE = ("temperature", "temperature_rate")

_AGAIN = "the same once more: what the sensor has comes back, what happened once does not"
_OF_MOTION = {
    "rate and direction of gravity": "turns at several rates about axes that point several ways",
    "its own rate": "turns at several rates, both ways",
    "rate about the other axes": "slow and fast turns about one axis at a time",
    "speed of rotation": "slow and fast turns about every axis",
    "direction of gravity": "more poses, spread over all directions",
    "orientation": "the same poses with the bench turned to other headings",
    "the pose before": "the same poses in another order",
    "the turn before": "the same poses, reached by other turns",
    "temperature": "the same poses at other temperatures",
    "temperature and direction of gravity": "the same poses at other temperatures",
    "temperature and rate about the other axes": "the same turns at other temperatures",
    "time since the last turn": "long rests after turns about one axis at a time, slow and fast",
    SIGN: "the counts as the converter gives them, before a host scales or cuts them",
    HEADING: "the same beside a reference that keeps its heading, as markers do",
}
"""What tells a function of the motion from physics; of time, a repetition does."""


def to_separate(effect: Effect, rivals: tuple[Rival, ...]) -> str:
    """Say what to record so that a finding and its rivals come apart."""
    if not rivals:
        return ""
    slugs = [effect.slug, *(r.effect for r in rivals)]
    clock = any(s.endswith(_CLOCK_LIKE) or s.startswith("time ") for s in slugs)
    heat = any(s.endswith(_HEAT_LIKE) for s in slugs)
    if clock and heat:
        return (
            "Cool the sensor while you repeat the poses, so that temperature and time since "
            "power-on do not rise together."
        )
    known = effects()
    parts = [f"{known[s].title}: {known[s].needs}" for s in slugs if s in known]
    for s in (s for s in slugs if s not in known):
        parts.append(f"{s}: {_OF_MOTION.get(s, _OF_MOTION.get(s.rpartition(' ')[0], _AGAIN))}")
    return "To tell them apart, record what each needs. " + "; ".join(parts) + "."


def changes(outcome: Outcome) -> tuple[tuple[Change, ...], tuple[float, float]]:
    """Return residual RMS and log-likelihood before and after, on the rows that were fitted."""
    rows = outcome.rows
    residual = rows.residual
    before = np.hstack((rows.baseline, rows.nuisance))
    after = fitted(rows, outcome.accepted)
    out: dict[str, list[float]] = {}
    units = {}
    likelihood = []
    for mean in (before, after):
        whitener = make_whitener(rows, outcome.levels, outcome.contrast, mean)
        white = whitener.project(residual)
        likelihood.append(-0.5 * float(white @ white))
        fit = whitener.whiten(residual)
        coefficients = np.linalg.lstsq(whitener.whiten(mean), fit, rcond=1e-10)[0]
        left = residual - mean @ coefficients
        floor = np.append(rows.variance(outcome.levels), outcome.contrast)
        keep = 1.0 - whitener.basis.shape[1] / len(residual)
        for label, unit, own in _row_kinds(rows):
            out.setdefault(label, []).append(float(np.sqrt(np.mean(np.square(left[own])))))
            units[label] = (unit, float(np.sqrt(np.mean(floor[own]) * keep)))
    found = tuple(
        Change(label, units[label][0], v[0], v[1], units[label][1]) for label, v in out.items()
    )
    return found, (likelihood[0], likelihood[1])


def _row_kinds(rows: Rows) -> list[tuple[str, str, FloatArray]]:
    where = "at rest" if rows.is_rest.any() else "over windows"
    out = []
    for label, unit, own in (
        (f"accel {where}", "m/s²", (rows.kind <= Kind.CONTRAST) & (rows.channel // 3 == 0)),
        (f"gyro {where}", "rad/s", (rows.kind <= Kind.CONTRAST) & (rows.channel // 3 == 1)),
        ("attitude after turns", "rad", rows.kind == Kind.ATTITUDE),
        ("velocity after turns", "m/s", rows.kind == Kind.VELOCITY),
    ):
        if own.any():
            out.append((label, unit, own))
    return out


def verdict(
    findings: tuple[Finding, ...], unexplained: tuple[Unexplained, ...], *, able: bool
) -> Verdict:
    """Return the verdict."""
    if findings and unexplained:
        return "partly_explained"
    if findings:
        return "explained"
    if unexplained:
        return "unexplained"
    return "consistent" if able else "undetermined"
