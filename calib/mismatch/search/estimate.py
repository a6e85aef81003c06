"""The joint fit of all that was found: sizes, shapes between the grid's, and standard errors.

A time constant or a bandwidth enters nonlinearly, and what a recording says of it is often
lopsided: an exponential much longer than the recording is a straight line, however long. So a shape
is not linearised. The likelihood is followed along it with all else refitted (the profile).
Standard errors are those of the mixture over it, with the profile as weights, and never less than a
third of the longer side of the interval in which the profile stays within 4.5 of its maximum. A
form (the order of a filter) that fits nearly as well is part of the mixture.

The noise is an estimate too: of slow drift a recording shows a few modes only. Standard errors are
as much wider as it takes for three of them to hold an error as often as three do where the noise is
known. Where a truth has noise of its own, what it errs by goes together in channels and shapes of
one window: there they are no less than what the residuals of whole windows say [1]_.

References
----------
.. [1] Liang, Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73,
   1986, p. 15 (the robust covariance of clusters).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import ndtr

from calib.effects import get_effect
from calib.effects.base import ShapeParameter
from calib.mismatch.hypotheses.families import (
    around,
    candidate_columns,
    forms,
    shape_grid,
)
from calib.mismatch.noise.noise import make_whitener, spread_of_variance
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, fitted
from calib.mismatch.search.joint import cut, prior_rows, scaled, triangle
from calib.mismatch.search.refine import likelihood_gain
from calib.types import BoolArray, FloatArray

POINTS = 25
"""Values of a shape at which the profile is taken."""

REACH = 8.0
"""How far below its maximum the log-likelihood is followed: four standard errors."""

WITHIN = 4.5
"""How far below its maximum the log-likelihood is three standard errors away."""

FINE = 9
"""Values within that reach that show the profile's form."""

NODES, HALVINGS = 40, 20
"""Values of an uncertain variance that are averaged over, and steps to where three errors end."""

SWEEPS = 2
"""Each shape is settled so often, given the others."""

UNIQUE = 1e-6
"""Share of a parameter that may lie in directions that are not, where it is determined."""

RANK = 1e-9
"""Singular value, of the largest, up to which a direction is not determined."""


@dataclass(frozen=True, eq=False)
class Windows:
    """What whole windows say of the errors of p coefficients.

    ``wider`` (p,) is how much larger they are, or 1, than if rows erred apart; ``count`` (p,) how
    many windows tell of each.
    """

    wider: FloatArray
    count: FloatArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """The joint fit of everything: steps from where the rows stand, and their covariance.

    Parameters
    ----------
    step, covariance : (p,), (p, p) arrays
        Of baseline, nuisances and each finding's coefficients, in units of their columns.
    at : tuple of int
        Where the coefficients of each finding start, and where the last ones end.
    shapes : mapping
        Standard error of a shape parameter, by number of the finding and name.
    beside : mapping
        Covariance (p,) of a shape parameter with all coefficients, likewise; none of a moment.
    forms : mapping
        Probability of the form that a finding has (the order of a filter), by number of the
        finding, where there are several.
    left : (m,) array
        Residual of the fit.
    determined : (p,) array of bool
        Which coefficients are the same in all fits that leave as little. Of others the shortest is
        given, and neither that nor its covariance says how far they are off.
    windows : Windows, or None
        Where windows say what the errors are.
    """

    step: FloatArray
    covariance: FloatArray
    at: tuple[int, ...]
    shapes: Mapping[tuple[int, str], float]
    beside: Mapping[tuple[int, str], FloatArray]
    forms: Mapping[int, float]
    left: FloatArray
    determined: BoolArray
    windows: Windows | None = None

    def joint(self, which: Sequence[tuple[int, str]]) -> FloatArray:
        """Return the covariance of all coefficients, and of some shapes after them.

        Of two shapes it is not known, and taken as none.
        """
        beside = np.array([self.beside[key] for key in which]).reshape(len(which), len(self.step))
        own = np.diag([self.shapes[key] ** 2 for key in which])
        return np.block([[self.covariance, beside.T], [beside, own]])


def settle(
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
    *,
    reference: bool,
) -> tuple[Rows, list[Accepted]]:
    """Return rows with every finding's part in them, and findings with the best of all shapes."""
    residual = rows.residual + sum(a.columns @ (a.values / a.typical) for a in accepted)
    rows = rows.with_residual(residual)
    out = [replace(a, values=np.zeros(len(a.values)), in_model=False) for a in accepted]
    shaped = [(i, item) for i, a in enumerate(out) for item in _shapes(a)]
    for _ in range(SWEEPS if len(shaped) > 1 else 1):
        for i, item in shaped:
            profiles = [
                (form, *_profile(rows, out, i, form, item, levels, contrast, reference=reference))
                for form in _forms(out[i])
            ]
            form, values, gains = max(profiles, key=lambda p: p[2].max())
            shape = {**form, item.name: _peak(values, gains)}
            best = _moved(rows, out[i], shape, reference=reference)
            out[i] = out[i] if best is None else best
    return rows, out


def estimate(
    rows: Rows,
    accepted: tuple[Accepted, ...],
    levels: FloatArray,
    contrast: FloatArray,
    *,
    reference: bool,
) -> Estimate:
    """Fit baseline, nuisances and all findings jointly, over all shapes that the rows allow."""
    best, covariance, determined = solved(rows, accepted, levels, contrast)
    total, shapes, of_form = covariance.copy(), {}, {}
    beside: dict[tuple[int, str], FloatArray] = {}
    reach = 3.0 * np.sqrt(np.diag(covariance))
    for i, a in enumerate(accepted):
        for item in _shapes(a):
            tried: list[dict[str, float]] = []
            found: list[FloatArray] = []
            for form in _forms(a):
                values, gains = _profile(
                    rows, list(accepted), i, form, item, levels, contrast, reference=reference
                )
                tried += [{**form, item.name: float(v)} for v in values]
                # Even in the logarithm, but finer where the profile is narrow.
                found.append(np.stack((gains, np.full(len(gains), np.log(values[1] / values[0])))))
            gains, spacing = np.hstack(found)
            drop = gains.max() - gains
            weights = np.exp(-drop) * spacing / (np.exp(-drop) @ spacing)
            if len(found) > 1:
                # Its own form comes first.
                of_form[i] = float(weights[: found[0].shape[1]].sum())
            values = np.array([shape[item.name] for shape in tried])
            off = values - a.candidate.shape[item.name]
            along = np.zeros(len(best))
            for shape, weight, lost, apart in zip(tried, weights, drop, off, strict=True):
                if lost > REACH:
                    continue
                other = _moved(rows, a, shape, reference=reference)
                if other is None:
                    continue
                there = (*accepted[:i], other, *accepted[i + 1 :])
                step, own, _ = solved(rows, there, levels, contrast)
                shift = step - best
                total += weight * (own - covariance + np.outer(shift, shift))
                along += weight * apart * shift
                if lost < WITHIN:
                    width = np.sqrt(2.0 * (WITHIN - lost) * np.diag(own))
                    reach = np.maximum(reach, np.abs(shift) + width)
            mixed = float(np.sqrt(weights @ np.square(off)))
            sigma = max(mixed, float(np.abs(off[drop < WITHIN]).max()) / 3.0)
            shapes[i, item.name] = sigma
            beside[i, item.name] = along * (sigma / mixed) if mixed > 0 else along
        for item in _moments(a):
            shapes[i, item.name] = _of_moment(
                rows, list(accepted), i, item, levels, contrast, reference=reference
            )
    size = np.sqrt(np.diag(total))
    unsure = _unsure(rows, accepted, levels, contrast, covariance)
    windows = None
    if rows.clustered:
        windows = _together(rows, accepted, levels, contrast)
        unsure = unsure * windows.wider
    longer = unsure * np.maximum(reach / 3.0, size) / np.where(size > 0, size, 1.0)
    total *= np.outer(longer, longer)
    start = rows.baseline.shape[1] + rows.nuisance.shape[1]
    at = np.cumsum([start, *(a.columns.shape[1] for a in accepted)])
    for i, name in shapes:
        # What a shape changes is as slow as what it shapes.
        wide = float(unsure[at[i] : at[i + 1]].max())
        shapes[i, name] *= wide
        if (i, name) in beside:
            beside[i, name] *= wide * longer
    left = rows.residual - fitted(rows, accepted) @ best
    first = tuple(int(k) for k in at)
    return Estimate(best, total, first, shapes, beside, of_form, left, determined, windows)


def unique(inverse: FloatArray, design: FloatArray) -> BoolArray:
    """Return which elements are the same in all solutions of a design, by its pseudo-inverse."""
    return np.asarray(np.einsum("pm,mp->p", inverse, design) > 1.0 - UNIQUE)


def _unsure(
    rows: Rows,
    accepted: tuple[Accepted, ...],
    levels: FloatArray,
    contrast: FloatArray,
    covariance: FloatArray,
) -> FloatArray:
    """Return how much wider errors are, as the noise is uncertain, than where it is known."""
    mean = fitted(rows, accepted)
    whitener = make_whitener(rows, levels, contrast, mean[:, :0])
    influence = whitener.unwhiten_transposed(whitener.whiten(mean) @ covariance)
    return wider(spread_of_variance(rows, mean, levels, influence, np.diag(covariance)))


def _together(
    rows: Rows, accepted: tuple[Accepted, ...], levels: FloatArray, contrast: FloatArray
) -> Windows:
    """Return how much wider errors are, as rows of one segment err together, than if none did.

    Of an estimate ``g' y`` of whitened rows y, which leaves the residuals r, the variance is the
    sum over segments of ``(g_k' r_k)²``; if rows erred apart, it were ``g' g``. What few segments
    tell of may look smaller so than it is: it counts where it is larger. What is known beforehand
    errs as it says. Residuals are those of all columns fitted at once: what is put aside moves the
    others by what `solved` adds, and that is no noise.

    References
    ----------
    .. [1] F. E. Satterthwaite, "An approximate distribution of estimates of variance components",
       Biometrics Bulletin 2(6), 1946, p. 110: how many terms of a sum of squares count.
    """
    design, _, y = _weighed(rows, accepted, levels, contrast)
    aside = cut(rows, accepted)
    influence = _inverse(design, aside)
    at_once = pseudo_inverse(design) if aside.any() else influence
    plain = np.square(influence).sum(axis=1)
    m = len(rows.residual)
    moved = influence * (y - design @ (at_once @ y))
    sums = np.zeros((int(rows.segment.max()) + 1, len(moved)))
    np.add.at(sums, rows.segment, moved[:, :m].T)
    variance = np.square(sums).sum(axis=0) + np.square(influence[:, m:]).sum(axis=1)
    ratio = variance / np.where(plain > 0, plain, np.inf)
    tell = np.zeros_like(sums)
    np.add.at(tell, rows.segment, np.square(influence[:, :m]).T)
    all_of_them = np.square(tell.sum(axis=0))
    count = all_of_them / np.maximum(np.square(tell).sum(axis=0), np.finfo(float).tiny)
    return Windows(np.sqrt(np.maximum(ratio, 1.0)), np.maximum(count, 1.0))


def wider(spread: FloatArray) -> FloatArray:
    """Return what to multiply standard errors by whose squares' logarithms have this deviation.

    Normal errors of log-normal variance are then within three of them as often as normal ones.
    """
    node, weight = hermegauss(NODES)
    scale = np.exp(0.5 * spread[:, None] * node)
    low, high = np.full(len(spread), 1.0), np.exp(1.5 * spread)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        beyond = ndtr(-3.0 * middle[:, None] / scale) @ weight / weight.sum()
        low = np.where(beyond > ndtr(-3.0), middle, low)
        high = np.where(beyond > ndtr(-3.0), high, middle)
    return 0.5 * (low + high)


class Solved(NamedTuple):
    """A least-squares step, its covariance, and which of it is the same in all fits as good.

    What is not determined goes with others in what nobody can tell apart.
    """

    step: FloatArray
    covariance: FloatArray
    determined: BoolArray


def solved(
    rows: Rows, accepted: tuple[Accepted, ...], levels: FloatArray, contrast: FloatArray
) -> Solved:
    """Return the least-squares step of all columns, of any rank, and its covariance."""
    design, scale, y = _weighed(rows, accepted, levels, contrast)
    design, y = triangle(design, y)
    aside = cut(rows, accepted)
    inverse = _inverse(design, aside)
    step = inverse @ y
    if aside.any():
        step[aside] = inverse[aside] @ (y - design[:, ~aside] @ step[~aside])
    covariance = inverse @ inverse.T
    if aside.any():
        # Its part within reach of the physics is not seen, but of the size of what is.
        size = step[aside] / scale[aside]
        hidden = inverse[~aside] @ design[:, aside] * scale[aside]
        covariance[np.ix_(~aside, ~aside)] += np.mean(size**2) * hidden @ hidden.T
    determined = unique(inverse, design)
    return Solved(step / scale, covariance / np.outer(scale, scale), determined)


def _weighed(
    rows: Rows, accepted: tuple[Accepted, ...], levels: FloatArray, contrast: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return all columns, whitened and of unit length, their lengths, and the same of residuals.

    Below the rows is what is known beforehand.
    """
    mean = fitted(rows, accepted)
    whitener = make_whitener(rows, levels, contrast, mean[:, :0])
    prior, value = prior_rows(rows, accepted)
    design, scale = scaled(np.vstack((whitener.whiten(mean), prior)))
    return design, scale, np.append(whitener.whiten(rows.residual), value)


def _inverse(design: FloatArray, aside: BoolArray) -> FloatArray:
    """Return what makes steps of data: of what is put ``aside`` beside what is fitted first."""
    out = np.zeros(design.T.shape)
    for own in (~aside, aside):
        if own.any():
            out[own] = pseudo_inverse(design[:, own])
    return out


def pseudo_inverse(design: FloatArray) -> FloatArray:
    """Return what makes of data the shortest of all least-squares solutions."""
    u, s, vt = np.linalg.svd(design, full_matrices=False)
    good = s > RANK * s[0]
    return np.asarray((vt[good].T / s[good]) @ u[:, good].T)


def _shapes(a: Accepted) -> list[ShapeParameter]:
    """Return the continuous shape parameters of a finding but for its moment."""
    if not a.candidate.physical:
        return []
    shape = get_effect(a.candidate.name).shape
    return [item for item in shape if item.spacing == "log" and item.name in a.candidate.shape]


def _moments(a: Accepted) -> list[ShapeParameter]:
    """Return the moment of a finding, if it has one: it is searched elsewhere."""
    if not a.candidate.physical:
        return []
    shape = get_effect(a.candidate.name).shape
    return [item for item in shape if item.is_moment and item.name in a.candidate.shape]


def _forms(a: Accepted) -> list[dict[str, float]]:
    """Return the shapes of a finding in all its forms, such as the orders of a filter."""
    return forms(get_effect(a.candidate.name), a.candidate.shape)


def _moved(
    rows: Rows, a: Accepted, shape: Mapping[str, float], *, reference: bool
) -> Accepted | None:
    """Return a finding with another shape; None if it has no columns there."""
    columns = candidate_columns(rows, a.candidate, shape, reference=reference)
    if columns is None:
        return None
    return replace(a, candidate=replace(a.candidate, shape=shape), columns=columns)


def _profile(
    rows: Rows,
    accepted: list[Accepted],
    which: int,
    form: Mapping[str, float],
    item: ShapeParameter,
    levels: FloatArray,
    contrast: FloatArray,
    *,
    reference: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return values of a shape, evenly spread in their logarithm, and their log-likelihood."""
    others = [a for i, a in enumerate(accepted) if i != which]
    whitener = make_whitener(rows, levels, contrast, fitted(rows, others))
    y = whitener.project(rows.residual)
    values = shape_grid(item, rows, POINTS)
    while True:
        gains = np.zeros(len(values))
        for k, value in enumerate(values):
            shape = {**form, item.name: float(value)}
            moved = _moved(rows, accepted[which], shape, reference=reference)
            if moved is not None:
                gains[k] = likelihood_gain(
                    whitener.project(moved.columns), y, present=moved.candidate.present
                )
        near = np.flatnonzero(gains > gains.max() - REACH)
        # A step finer than a thousandth is finer than any use of it.
        if len(near) >= FINE or values[1] < 1.001 * values[0]:
            return values, gains
        low, high = max(near[0] - 1, 0), min(near[-1] + 1, len(values) - 1)
        # Two tops far apart: what lies between them is taken along.
        number = POINTS if high - low < len(values) - 1 else 2 * len(values)
        values = np.geomspace(values[low], values[high], number)


def _of_moment(
    rows: Rows,
    accepted: list[Accepted],
    which: int,
    item: ShapeParameter,
    levels: FloatArray,
    contrast: FloatArray,
    *,
    reference: bool,
) -> float:
    """Return the standard error of a moment: in which rest or turn it is is open, and when."""
    own = accepted[which]
    here = own.candidate.shape[item.name]
    others = [a for i, a in enumerate(accepted) if i != which]
    whitener = make_whitener(rows, levels, contrast, fitted(rows, others))
    y = whitener.project(rows.residual)
    k = rows.segment_at(here)
    values, length = rows.interval.mean(axis=1), np.ptp(rows.interval, axis=1)
    near = slice(max(k - 1, 0), k + 2)
    begin, end = around(rows, k)
    part = (end - begin) / POINTS
    within = begin[:, None] + part[:, None] * (np.arange(POINTS) + 0.5)
    values = np.concatenate((np.delete(values, near), within.ravel(), [here]))
    length = np.concatenate((np.delete(length, near), np.repeat(part, POINTS), [part.min()]))
    gains = np.zeros(len(values))
    for i, value in enumerate(values):
        shape = {**own.candidate.shape, item.name: float(value)}
        moved = own if value == here else _moved(rows, own, shape, reference=reference)
        if moved is not None:
            gains[i] = likelihood_gain(whitener.project(moved.columns), y)
    drop, off = gains.max() - gains, np.abs(values - here)
    weights = np.exp(-drop) * length / (np.exp(-drop) @ length)
    mixed = np.sqrt(weights @ (np.square(off) + length**2 / 12.0))
    return float(max(mixed, off[drop < WITHIN].max() / 3.0))


def _peak(values: FloatArray, gains: FloatArray) -> float:
    """Return where a profile is highest: the top of a parabola through its three highest values."""
    k = int(np.argmax(gains))
    if k in (0, len(values) - 1):
        return float(values[k])
    below, top, above = gains[k - 1 : k + 2]
    bend = below - 2 * top + above
    shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(values[k] * (values[1] / values[0]) ** shift)
