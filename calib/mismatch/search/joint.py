"""One linear step of all that is fitted at once, with what is known beforehand."""

from __future__ import annotations

import numpy as np

from calib.effects import get_effect
from calib.mismatch.hypotheses.factors import LARGE, SCALES
from calib.mismatch.hypotheses.slipped import angle_of
from calib.mismatch.noise.noise import make_whitener
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, fitted
from calib.types import BoolArray, FloatArray

THERE = 1e-6
"""How far the coefficient of what is there or not may be from one."""


def solve(
    rows: Rows,
    accepted: list[Accepted] | tuple[Accepted, ...],
    levels: FloatArray,
    contrast: FloatArray,
) -> FloatArray:
    """Return the generalised least-squares step of all that is fitted; `cut` columns stay."""
    mean = fitted(rows, accepted)
    kept = ~cut(rows, accepted)
    step = np.zeros(mean.shape[1])
    mean = mean[:, kept]
    whitener = make_whitener(rows, levels, contrast, mean[:, :0])
    prior, value = prior_rows(rows, accepted, whole=True)
    design, scale = scaled(np.vstack((whitener.whiten(mean), prior[:, kept])))
    y = np.append(whitener.whiten(rows.residual), value)
    found = np.linalg.lstsq(*triangle(design, y), rcond=1e-9)[0]
    step[kept] = found / scale
    return step


def triangle(design: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rows with all products of columns (m, p) and y (m,): p + 1, where m is more."""
    both = np.asarray(np.linalg.qr(np.column_stack((design, y)), mode="r"))
    return both[:, :-1], both[:, -1]


def prior_rows(
    rows: Rows, accepted: list[Accepted] | tuple[Accepted, ...], *, whole: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return rows (k, p) of the priors, and their values (k,).

    No effect is larger than it physically can be: a g-sensitivity that all axes have alike is the
    vertical part of the Earth's rotation, but for the size of that. Baseline and alignment have
    theirs from the rows. Beside a reference no finding is beyond the largest size that has
    evidence: what the motion leaves open (the height of a sensor over a table that turns about the
    vertical) stays there. A smooth function can take the place of the baseline. At rest the two are
    exactly alike, but in motion, or beside a truth with noise, only nearly so; what keeps them
    apart is the size that the evidence gave the rival, at most `LARGE`. With ``whole`` what is
    there or not is there: how strong it is is in its shape alone.
    """
    start = rows.baseline.shape[1] + rows.nuisance.shape[1]
    width = start + sum(a.columns.shape[1] for a in accepted)
    spread = np.full(width, np.inf)
    value = np.zeros(width)
    if len(rows.prior):
        spread[:start], value[:start] = rows.prior[:, 1], -rows.prior[:, 0]
    at = start
    for a in accepted:
        own = slice(at, at + a.columns.shape[1])
        if not a.candidate.physical:
            # How far a sensor may turn is known: half a radian, as it were.
            spread[own] = LARGE if angle_of(a.candidate) is None else SCALES[-1]
        else:
            least, most = get_effect(a.candidate.name).limits(a.candidate.parameters)
            far = np.maximum(-least, most) / a.typical
            spread[own] = np.minimum(far, SCALES[-1]) if rows.aligned else far
        if whole and a.candidate.present:
            spread[own], value[own] = THERE, 1.0
        if a.in_model:
            value[own] = -a.values / a.typical
        at = own.stop
    known = np.isfinite(spread)
    return np.diag(1.0 / spread)[known], (value / spread)[known]


def cut(rows: Rows, accepted: list[Accepted] | tuple[Accepted, ...]) -> BoolArray:
    """Return which fitted columns must not move the physics, (p,) bool.

    Beside a reference these are the rivals that act everywhere: a smooth function of the motion can
    take the place of a lever arm or of a rotation, and nobody knows its size. What stays
    unexplained is then fitted to what the physics leaves. A rival in a window takes its window out.

    References
    ----------
    .. [1] Liu, Bayarri, Berger, "Modularization in Bayesian analysis", Bayesian Analysis 4, 2009.
    .. [2] Brynjarsdottir, O'Hagan, "Learning about physical parameters: the importance of model
       discrepancy", Inverse Problems 30, 2014.
    """
    start = rows.baseline.shape[1] + rows.nuisance.shape[1]
    parts = [np.zeros(start, bool)]
    for a in accepted:
        smooth = not a.candidate.physical and a.candidate.interval is None
        parts.append(np.full(a.columns.shape[1], bool(rows.aligned) and smooth))
    return np.concatenate(parts)


def scaled(design: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns of unit length, and their lengths.

    Priors belong to the length: a column that shows next to nothing is all prior, and by what it
    shows alone its prior would be so steep that beside it nothing else had a rank.
    """
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = 1.0
    return design / size, size
