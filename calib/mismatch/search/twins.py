"""Twins of a finding: effects that mimic it so nearly that a recording cannot tell them apart.

What a finding explains is fitted, and so are its shapes: by chance it goes along with the drift of
the recording as well, which no other effect does. So a twin need not mimic the shape that fits
best, but any that the recording allows: two standard errors either way.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.calibration import Quantity
from calib.effects import get_effect
from calib.effects.base import Effect
from calib.effects.earth_rate import EarthRate
from calib.mismatch.findings.diagnosis import Rival
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import candidate_columns, neighbours
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.windows import own_signal
from calib.mismatch.noise.noise import Whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.refine import refined
from calib.recording import CHANNELS
from calib.types import FloatArray

MIMICKED = 9.0
"""Power of a finding, in units of the noise, that a twin does not mimic, below which the two are a
tie: the likelihood then favours the wrong one in 1 of 15."""

BLURRED = 0.0025
"""The same as a share of the finding's power, however strong it is: columns are made of measured
signals, of which the slow part that is left beside drift and baseline errs by 5 % (a thermometer is
not where the sensor is, and a rate of its temperature is a derivative)."""

LEAST = 0.5
"""Share of a finding's power that a twin mimics at least: of one that hardly shows beside later
findings, everything would be a twin."""

NEARLY = 4.0
"""How many times as much may be left of a twin at one of the grid's shapes, at its own."""

ALLOWED = 4.0
"""Power by which a shape may explain less than the best: two standard errors."""

SENSITIVITY = "gyro_g_sensitivity"
ALIKE_AXES = ("gxx", "gyy", "gzz")
"""What turns about the vertical: along each axis itself, and on all of them alike."""

STRAIGHT = "a straight line in time"
"""What drift follows that goes on."""

AGES, AGED = "a gain that grows with time", 0.3
"""What a scale factor that follows a temperature follows as well, where that rises evenly; and how
probable it is beside that: gains that change by themselves are less common than that they do."""

UNSETTLED = (
    "It has not settled when the recording ends: drift in a straight line looks the same, and how "
    "far it goes, and for how long, is not known."
)

HEADING = "heading of the reference"
"""What else may turn about the vertical."""

FAST = 1.5
"""Times the Earth's rate that what is taken for it may be, as it is measured."""

ALIKE, SHARE = 1.0, 1e-3
"""Power of a finding, and as a share of it, that one of its known rivals with more parameters must
leave at most: more parameters mimic more, but what they mimic wholly no recording like this one can
tell (the Earth's rotation about the vertical, and a g-sensitivity that is alike on all axes)."""


def twins(
    rows: Rows,
    stack: Stack,
    own: Accepted,
    evidence: FloatArray,
    whitener: Whitener,
    y: FloatArray,
    *,
    reference: bool,
) -> list[str]:
    """Return the groups of other effects that mimic a finding with no more parameters, or wholly.

    Parameters
    ----------
    rows, stack : Rows, Stack
    own : Accepted
    evidence : (k,) array
        Of each candidate of the stack.
    whitener, y : Whitener, (m,) array
        With all that is fitted but the finding; and what is left beside that.
    """
    explained = _fit(whitener.project(own.columns), y)
    power = float(np.square(explained).sum())
    most = min(max(MIMICKED, BLURRED * power), LEAST * power)
    allowed: list[FloatArray] = []
    out = []
    rivals = _rivals(stack, own, evidence)
    plain = [stack.of(candidate) for candidate in rivals]
    # All at once: whitening costs as much for one column as for many.
    ends = np.cumsum([columns.shape[1] for columns in plain])[:-1]
    seen = np.split(whitener.project(np.hstack(plain)), ends, axis=1) if plain else []
    for candidate, columns, white in zip(rivals, plain, seen, strict=True):
        if candidate.group in out:
            continue
        left = _left(white, explained)
        if most <= left <= NEARLY * most:
            allowed = allowed or [
                explained,
                *_shaped(rows, own, whitener, y, reference=reference),
            ]
            _, columns = refined(rows, candidate, columns, whitener, y, reference=reference)
            moved = whitener.project(columns)
            left = min(_left(moved, found) for found in allowed)
        if left < most:
            out.append(candidate.group)
    whole = min(max(ALIKE, SHARE * power), LEAST * power)
    for candidate in _wider(stack, own):
        if candidate.group not in out and (
            _left(whitener.project(stack.of(candidate)), explained) < whole
        ):
            out.append(candidate.group)
    return out


def turns_about_up(
    own: Accepted, whitener: Whitener, y: FloatArray, *, gravity: float, reference: bool
) -> str | None:
    """Return what else turns about the vertical as slowly as a finding, or None if it does not.

    A g-sensitivity that all axes have alike is such a turn: that of the Earth, unless headings are
    known and tell its horizontal part; and of a `reference` that drifts in heading, at any pace.
    """
    names = own.candidate.parameters
    if own.candidate.name != SENSITIVITY or not set(ALIKE_AXES) <= set(names):
        return None
    columns = whitener.project(own.columns)
    coefficients = np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    explained = columns @ coefficients
    which = [names.index(name) for name in ALIKE_AXES]
    alike = own.columns[:, which].sum(axis=1, keepdims=True)
    if _left(whitener.project(alike), explained) >= MIMICKED:
        return None
    size = float((coefficients[which] * own.typical[which]).mean()) * gravity
    least, most = get_effect("earth_rate").limits(("up",))
    if least[0] <= size / FAST <= most[0]:
        return "earth_rate"
    return HEADING if reference else None


def too_fast(
    effect: Effect, parameters: Mapping[str, Quantity], rivals: tuple[Rival, ...]
) -> tuple[tuple[Rival, ...], str]:
    """Return the rivals of a finding, and what to say, if it is an Earth that turns too fast.

    A `SENSITIVITY` that all axes have alike is the same as its part up, and first among them.
    """
    if not isinstance(effect, EarthRate):
        return rivals, ""
    values = {name: q.value for name, q in parameters.items()}
    times = effect.excess(values, {name: q.sigma or 0.0 for name, q in parameters.items()})
    if times <= 1.0:
        return rivals, ""
    own = next((r for r in rivals if r.effect == SENSITIVITY), Rival(SENSITIVITY, 1.0))
    return (own, *(r for r in rivals if r is not own)), (
        f"That would be {times:.2g} times as fast as it turns: a g-sensitivity that all axes have "
        "alike is the same as the part up."
    )


def straight(effect: Effect) -> Rival | None:
    """Return the rival that a finding of an effect has if `is_straight`; None if it has none."""
    if effect.from_power_on:
        return Rival(STRAIGHT, 1.0)
    return Rival(AGES, AGED) if effect.slug.endswith("_scale_temperature") else None


def is_straight(
    rows: Rows, own: Accepted, predicted: FloatArray, whitener: Whitener, *, gain: bool
) -> bool:
    """Whether a straight line in time, or such a gain, mimics what a finding adds to rows (m,).

    What fades more slowly than a recording lasts is one, as drift is that goes on. The whitener has
    all that is fitted but the finding.
    """
    explained, lines = whitener.project(predicted), []
    for c in map(CHANNELS.index, own.candidate.channels):
        carrier = own_signal(rows.state, c) if gain else 1.0
        lines.append(rows.columns(c, (carrier * rows.state.time)[:, None]))
    left = _left(whitener.project(np.hstack(lines)), explained)
    return left < min(MIMICKED, LEAST * float(np.square(explained).sum()))


def _wider(stack: Stack, own: Accepted) -> list[Candidate]:
    """Return the known rivals of a finding that have more parameters, with all of these."""
    known = get_effect(own.candidate.name).rivals
    best: dict[str, Candidate] = {}
    for c in stack.physics.values():
        if c.name in known and len(c.index) > own.columns.shape[1]:
            there = best.setdefault(c.group, c)
            if len(c.index) > len(there.index):
                best[c.group] = c
    return list(best.values())


def _rivals(stack: Stack, own: Accepted, evidence: FloatArray) -> list[Candidate]:
    """Return the best of each other effect, and the best with as many parameters as may be.

    What one axis mimics of three is a third.
    """
    number, groups = own.columns.shape[1], dict[str, list[int]]()
    every = stack.physics
    for i, c in every.items():
        if len(c.index) <= number and c.group != own.candidate.group:
            groups.setdefault(c.group, []).append(i)
    best: list[int] = []
    for few in groups.values():
        most = max(len(every[i].index) for i in few)
        full = [i for i in few if len(every[i].index) == most]
        best += dict.fromkeys(max(some, key=evidence.item) for some in (few, full))
    return [every[i] for i in best]


def _shaped(
    rows: Rows, own: Accepted, whitener: Whitener, y: FloatArray, *, reference: bool
) -> list[FloatArray]:
    """Return what a finding explains at other shapes that the recording allows."""
    if own.candidate.present:
        return []
    found = []
    for shape in neighbours(get_effect(own.candidate.name), rows, own.candidate.shape):
        columns = candidate_columns(rows, own.candidate, shape, reference=reference)
        if columns is not None:
            found.append(_fit(whitener.project(columns), y))
    power = [float(np.square(values).sum()) for values in found]
    best = max((float(np.square(_fit(whitener.project(own.columns), y)).sum()), *power))
    return [values for values, p in zip(found, power, strict=True) if p > best - ALLOWED]


def _fit(columns: FloatArray, y: FloatArray) -> FloatArray:
    """Return what whitened columns explain of y."""
    return np.asarray(columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0])


def _left(columns: FloatArray, y: FloatArray) -> float:
    """Return the power of y that whitened columns do not mimic."""
    return float(np.square(y - _fit(columns, y)).sum())
