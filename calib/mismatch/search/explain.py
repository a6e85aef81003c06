"""From the search's outcome to a diagnosis: numbers with standard errors, places, proof, words."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

from calib.calibration import Quantity, parameter_unit
from calib.effects import effects, get_effect
from calib.effects.base import Effect
from calib.mismatch.findings.diagnosis import Finding, Interval, Rival, Unexplained, Verdict
from calib.mismatch.findings.evidence import TIME, Regressor, gather
from calib.mismatch.findings.heldout import LeftOut, leave_out
from calib.mismatch.hypotheses.candidates import GAIN_IN_TIME
from calib.mismatch.hypotheses.places import joined
from calib.mismatch.hypotheses.rivals import FROM_START
from calib.mismatch.hypotheses.slipped import angle_of
from calib.mismatch.hypotheses.windows import APART, THROUGHOUT, touched
from calib.mismatch.noise.noise import Whitener, make_whitener
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import UNLIKE, Accepted, fitted
from calib.mismatch.search.counts import counted, is_whole
from calib.mismatch.search.estimate import Estimate
from calib.mismatch.search.late import firsts_late
from calib.mismatch.search.partly import IN_A_PART, Part, acting_part
from calib.mismatch.search.proof import fit_without, judging, only_levels, prove
from calib.mismatch.search.put_down import WORDS, put_down
from calib.mismatch.search.ranking import chance
from calib.mismatch.search.returned import THERE, returned
from calib.mismatch.search.search import BEATEN, SHOWN, TIE, TWIN, Outcome
from calib.mismatch.search.separate import to_separate
from calib.mismatch.search.twins import AGES, UNSETTLED, is_straight, straight, too_fast
from calib.mismatch.search.whole import DELAY
from calib.mismatch.search.witness import is_resolved
from calib.recording import CHANNELS, TRIADS
from calib.types import FloatArray

UNSURE = 0.05
"""P-value, all looks counted, above which a finding is not told from how windows scatter."""

LIKELY = 0.05
"""How rarely windows may scatter as they do by chance, for the noise that is assumed to stand."""

SOMETHING = 1e-3
"""The same, were the windows many, up to which there is something in the few that tell."""

TOGETHER = (
    "How large it is and how long it lasts go together: what is known is what both do, and neither "
    "by itself."
)
"""What is said where each number is within two of its standard errors of none."""

OF_POSES = "the pose: too few of them to tell by what"
"""What something follows of which nothing is left beside free levels of the poses."""


class _Case(NamedTuple):
    """What the findings of one outcome are judged by."""

    outcome: Outcome
    fit: Estimate
    names: tuple[str, ...]
    """Of the model's parameters, whose coefficients are first."""
    again: Mapping[int, Interval]
    """The findings that come back as often as what they follow, with where."""
    passed: set[int]
    """Those that others bring about: the first rests of one that was put down, and filters."""
    put_down: set[int]
    """Those that show in the first rests as well."""
    after: Callable[[], LeftOut]
    """What the fit of all findings says of blocks that are left out of it."""


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

    @cache
    def after() -> LeftOut:
        mean, levels, contrast = fitted(rows, accepted), outcome.levels, outcome.contrast
        return leave_out(rows, mean, rows.residual, levels=levels, contrast=contrast)

    first_rests = put_down(accepted)
    case = _Case(
        outcome=outcome,
        fit=fit,
        names=names,
        again=returned(fit, accepted),
        passed=set(first_rests) | _left_by_filters(outcome, fit),
        put_down=set(first_rests.values()),
        after=after,
    )
    judged = [_judge(case, i) for i in range(len(accepted))]
    stand = [i for i, item in enumerate(judged) if isinstance(item, Finding)]
    findings = [item for item in judged if isinstance(item, Finding)]
    unexplained = [item for item in judged if isinstance(item, Unexplained)]
    of_poses = [u for u in unexplained if u.follows == OF_POSES]
    others = [u for u in unexplained if u.follows != OF_POSES]
    known = _known(case, {name: k for k, name in enumerate(names)} | dict(further or {}), stand)
    return findings, joined([*others, *_of_poses(of_poses)]), known


def _known(
    case: _Case, model: Mapping[str, int], stand: Sequence[int]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and covariance of what is known of the sensor's model.

    ``model`` has the coefficients of its own parameters, ``stand`` the findings that stand.
    """
    fit, accepted = case.fit, case.outcome.accepted
    known = [name for name, k in model.items() if fit.determined[k]]
    index = [k for k in model.values() if fit.determined[k]]
    shapes: list[tuple[int, str]] = []
    for i in stand:
        candidate = accepted[i].candidate
        if get_effect(candidate.name).kind != "sensor":
            continue
        if not candidate.present:
            known += [f"{candidate.name}.{n}" for n in candidate.parameters]
            index += range(fit.at[i], fit.at[i + 1])
        shapes += [key for key in fit.beside if key[0] == i]
    known += [f"{accepted[i].candidate.name}.{name}" for i, name in shapes]
    index += [len(fit.step) + k for k in range(len(shapes))]
    scale = np.ones(len(fit.step) + len(shapes))
    for i, a in enumerate(accepted):
        scale[fit.at[i] : fit.at[i + 1]] = a.typical
    covariance = (fit.joint(shapes) * np.outer(scale, scale))[np.ix_(index, index)]
    return tuple(known), covariance


def _judge(case: _Case, which: int) -> Finding | Unexplained | None:
    """Return what is said of one thing that was found: nothing, if it is a part of another."""
    outcome, fit = case.outcome, case.fit
    a = outcome.accepted[which]
    if which in case.again:
        back = _unexplained(outcome, fit, which, ())
        return replace(back, intervals=(case.again[which],), follows=THERE)
    if which in case.passed:
        return None
    others = {b.candidate.name for i, b in enumerate(outcome.accepted) if i != which}
    rivals = tuple(r for r in _rivals(a, outcome.tried) if r.effect not in others)
    left = partial(_unexplained, outcome, fit, which, rivals)
    if not a.candidate.physical:
        return left()
    effect = get_effect(a.candidate.name)
    if effect.kind != "setup" and _is_nothing(fit, which):
        taken = _is_taken_over(outcome.accepted, which)
        if taken or not (a.candidate.present or effect.shape):
            return None
    part = _acting_part(outcome, which)
    if part is not None:
        rivals = (Rival(effect.slug, 1.0 / part.odds),)
        follows = f"{effect.follows}, {IN_A_PART}"
        return replace(left(), rivals=rivals, intervals=(part.interval,), follows=follows)
    if sum(r.odds for r in rivals) > BEATEN:
        # Of what so many others explain as well, none is said to be it.
        return replace(left(), follows=effect.follows)
    parameters = _parameters(a, effect, fit, which)
    if a.candidate.present:
        (name,) = a.candidate.parameters
        if not 0.5 < parameters[name].value < 1.5:
            # It is there or not: what fits by half, or the other way round, is something else.
            return replace(left(), follows=effect.follows)
        parameters[name] = Quantity(1.0, None, parameters[name].unit)
    absorbed, proof, before = prove(outcome, fit, which, case.names, case.after)
    if only_levels(outcome, which, proof):
        return replace(left(), rivals=(), follows=OF_POSES)
    if any(q.unit == "samples" and not is_whole(q) for q in parameters.values()):
        # Samples come whole: a part of one is something else that happened in this turn.
        moment = a.candidate.shape["moment"]
        if not is_resolved(outcome.rows, outcome.levels, outcome.rows.segment_at(moment)):
            return None
        where = _segment(outcome.rows, moment)
        return replace(left(), intervals=(where,), follows="this one turn")
    if effect.kind != "event" and (proof.gain <= 0 or proof.after >= proof.before):
        return replace(left(), follows=f"{effect.follows}, but not on held-out data")
    few, any_number = _of_windows(fit, which, a, looks=len(outcome.tried))
    if few > UNSURE:
        scattered = replace(left(), follows=f"{effect.follows}, but in few windows only")
        return scattered if any_number <= SOMETHING else None
    once = effect.kind == "event" and proof.gain <= 0
    words = [effect.sentence]
    if fit.forms.get(which, 0.0) > 1.0 - TIE:
        words.append(effect.in_words(a.candidate.shape))
    if effect.shape and _go_together(parameters.values()):
        words.append(TOGETHER)
    if which in case.put_down:
        words.append(WORDS)
    firsts = firsts_late(effect.slug, parameters)
    words += firsts.values()
    rivals, fast = too_fast(effect, parameters, rivals)
    predicted = a.columns @ fit.step[fit.at[which] : fit.at[which + 1]]
    slow, line = "", straight(effect)
    if line is not None and is_straight(
        outcome.rows, a, predicted, _beside(outcome, which), gain=line.effect == AGES
    ):
        rivals = tuple(sorted((line, *rivals), key=lambda r: -r.odds))
        slow = UNSETTLED if effect.from_power_on else ""
    return Finding(
        effect=effect.slug,
        title=effect.title,
        kind=effect.kind,
        channels=tuple(c for c in CHANNELS if c in {*_channels(effect, parameters), *firsts}),
        intervals=_intervals(outcome.rows, a),
        regime=effect.follows,
        parameters={n: counted(q) if q.unit == "samples" else q for n, q in parameters.items()},
        p_value=max(chance(a.e_value), few),
        absorbed_by=absorbed,
        held_out=None if once else proof,
        held_out_reason="it happened once: no other pose or turn shows it" if once else "",
        rivals=rivals,
        to_separate=to_separate(effect, rivals),
        sentence=" ".join(w for w in (*words, fast, slow) if w),
        evidence=gather(
            outcome.rows,
            effect.follows,
            predicted,
            before,
            fit.left,
            regressor=_regressor(a, effect, fit.step[fit.at[which] : fit.at[which + 1]]),
        ),
    )


def _regressor(a: Accepted, effect: Effect, step: FloatArray) -> Regressor | None:
    """Return what the largest part of a finding is in proportion to."""
    if a.candidate.present:
        return None
    return Regressor.of(effect, a.candidate.parameters, a.columns / a.typical, step * a.typical)


def _parameters(a: Accepted, effect: Effect, fit: Estimate, which: int) -> dict[str, Quantity]:
    """Return the parameters of a finding, those of its shape too, with standard errors."""
    part = slice(fit.at[which], fit.at[which + 1])
    values = fit.step[part] * a.typical
    sigma = np.sqrt(np.diag(fit.covariance)[part]) * a.typical
    out = {
        n: Quantity(float(v), float(s), parameter_unit(f"{effect.slug}.{n}"))
        for n, v, s in zip(a.candidate.parameters, values, sigma, strict=True)
    }
    for item in effect.shape:
        if item.name in a.candidate.shape:
            here, spread = a.candidate.shape[item.name], None
            if item.spacing == "log" or item.is_moment:
                spread = fit.shapes[which, item.name]
            out[item.name] = Quantity(float(here), spread, item.unit)
    return out


def _acting_part(outcome: Outcome, which: int) -> Part | None:
    """Return the part of a recording that a finding acts in, if it is not all of it."""
    if outcome.rows.clustered:
        return None
    rows = judging(outcome, which)
    return acting_part(rows, outcome.accepted, which, outcome.levels, outcome.contrast)


def _is_taken_over(accepted: Sequence[Accepted], which: int) -> bool:
    """Whether something was found later on the channels of an effect, and has no name.

    What wanders, or follows where the sensor points, looks like a step at first.
    """
    own = accepted[which].candidate
    later = (a.candidate for a in accepted[which + 1 :] if not a.candidate.physical)
    return not own.present and any(set(c.channels) & set(own.channels) for c in later)


def _is_nothing(fit: Estimate, which: int) -> bool:
    """Whether nothing is left of something beside all else that was found."""
    part = slice(fit.at[which], fit.at[which + 1])
    step, covariance = fit.step[part], fit.covariance[part, part]
    return float(chdtrc(len(step), step @ np.linalg.pinv(covariance) @ step)) > UNSURE


def _beside(outcome: Outcome, which: int) -> Whitener:
    """Return the whitener with all that was fitted but one finding projected out."""
    others = [a for i, a in enumerate(outcome.accepted) if i != which]
    mean = fitted(outcome.rows, others)
    return make_whitener(outcome.rows, outcome.levels, outcome.contrast, mean)


def _left_by_filters(outcome: Outcome, fit: Estimate) -> set[int]:
    """Return the findings that are what a filter of another make leaves of its effect.

    No filter is exactly of the forms that are tried. What another form or cut-off would explain
    better is that of one that was found first (or later, if it is better by far), and so is what
    another explains nearly as well, or what is another gain in every turn, if it is smaller than
    what filters are unlike by. One that is worked out at the samples is earlier than its pole says,
    by up to half of their interval.
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
        if _is_early(outcome, fit, i):
            out.add(i)
            continue
        own = a.posterior.get(a.candidate.group, 0.0)
        for k in filters:
            b = accepted[k]
            small = power[i] < UNLIKE**2 * power[k]
            apart = a.candidate.name == GAIN_IN_TIME and a.candidate.shape == APART
            if small and apart and _is_within(a, b):
                out.add(i)
            other = a.posterior.get(b.candidate.group, 0.0)
            if b.candidate.group == a.candidate.group or (k > i and other < BEATEN * own):
                continue
            if other > own or (other > TIE * own and small):
                out.add(i)
    return out


def _is_within(one: Accepted, other: Accepted) -> bool:
    """Whether one finding is on no channel that another is not on."""
    return set(one.candidate.channels) <= set(other.candidate.channels)


def _is_early(outcome: Outcome, fit: Estimate, which: int) -> bool:
    """Whether a finding has a triad earlier than the low-pass of it, by half a sample at most."""
    a = outcome.accepted[which]
    if a.candidate.name != DELAY or len(a.typical) > 1:
        return False
    early = -float(a.typical[0] * fit.step[fit.at[which]])
    filters = (b.candidate for b in outcome.accepted if b.candidate.present)
    alike = any(c.channels == a.candidate.channels for c in filters)
    return alike and 0.0 < early < 0.5 * outcome.rows.state.interval


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


def _of_poses(items: list[Unexplained]) -> list[Unexplained]:
    """Return what differs between the few poses there are, one item a triad."""
    out = []
    for triad in TRIADS:
        own = [u for u in items if u.channels[0].startswith(triad)]
        if own:
            channels = {c for u in own for c in u.channels}
            first = min(own, key=lambda u: u.p_value)
            ordered = tuple(c for c in CHANNELS if c in channels)
            out.append(replace(first, channels=ordered))
    return out


def _rivals(a: Accepted, tried: Collection[str]) -> tuple[Rival, ...]:
    """Return the rivals of something that was found, among all effects that were ``tried``."""
    # Of what has come to be less than is said, rivals are so much more probable, at least.
    own = max(a.posterior.get(a.candidate.group, SHOWN), SHOWN)
    found = [
        Rival(name, value / own)
        for name, value in a.posterior.items()
        if name != a.candidate.group and value > (TWIN if name in effects() else TIE)
    ]
    found.sort(key=lambda r: -r.odds)
    heat = a.candidate.name.replace("_warm_up", "_bias_temperature")
    if heat != a.candidate.name and heat not in tried:
        # What warms up does so in time; without a thermometer, or with one that is stuck, nobody
        # can tell which it follows.
        found.insert(0, Rival(heat, 1.0))
    return tuple(found)


def _unexplained(
    outcome: Outcome, fit: Estimate, which: int, rivals: tuple[Rival, ...]
) -> Unexplained:
    rows, a = outcome.rows, outcome.accepted[which]
    c = a.candidate
    begin, end = float(rows.interval[0, 0]), float(rows.interval[-1, 1])
    # What fades may do so beyond the end.
    where = (begin, end) if c.interval is None else (c.interval[0], min(c.interval[1], end))
    angle = angle_of(c)
    follows = get_effect(c.name).follows if c.physical else c.name
    in_time = c.interval is not None or TIME in follows or follows in (THROUGHOUT, FROM_START)
    predicted = a.columns @ fit.step[fit.at[which] : fit.at[which + 1]]
    before, x = fit_without(outcome, which)[0], TIME if in_time else follows
    seen = gather(rows, x, predicted, before, fit.left, on=touched(c))
    at_rest = seen is not None and any(s.channel in CHANNELS for s in seen.series[:1])
    return Unexplained(
        channels=touched(c),
        intervals=(where,),
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
    """Return the channels that a parameter touches which is there, at the strictest that any is."""
    for errors in (3.0, 2.0, 0.0):
        found = set()
        for p in effect.parameters:
            q = parameters.get(p.name)
            if q is not None and (q.sigma is None or abs(q.value) >= errors * q.sigma):
                found |= set(p.channels)
        if found:
            break
    return tuple(c for c in CHANNELS if c in found)


def _intervals(rows: Rows, a: Accepted) -> tuple[Interval, ...]:
    start, stop = float(rows.interval[0, 0]), float(rows.interval[-1, 1])
    effect = get_effect(a.candidate.name)
    if effect.kind == "event":
        for item in effect.shape:
            if item.is_moment:
                start = a.candidate.shape[item.name]
    lost = any(p.unit == "samples" for p in effect.parameters)
    if lost and not rows.aligned:
        # By itself a recording shows it in one turn alone; beside a truth all that follows is late.
        return (_segment(rows, start),)
    return ((start, stop),)


def _go_together(parameters: Iterable[Quantity]) -> bool:
    """Whether none of several numbers is known by itself, though what they do together is."""
    known = [abs(q.value) > 2.0 * q.sigma for q in parameters if q.sigma]
    return len(known) > 1 and not any(known)


def _segment(rows: Rows, moment: float) -> Interval:
    """Return the rest or turn that a moment lies in."""
    start, stop = rows.interval[rows.segment_at(moment)].tolist()
    return start, stop


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
