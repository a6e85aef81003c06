"""The shape of what was accepted, between those that were tried: where it explains most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.effects import get_effect
from calib.effects.base import TransformEffect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.ends import Told, place_window, tune_wave
from calib.mismatch.hypotheses.families import (
    NEAR,
    SHAPES,
    candidate_columns,
    forms,
    neighbours,
    shape_grid,
)
from calib.mismatch.hypotheses.peak import close_in
from calib.mismatch.hypotheses.slipped import angle_of, slip_columns
from calib.mismatch.hypotheses.windows import THROUGHOUT, has_ends, window_columns
from calib.mismatch.noise.noise import Whitener, level_basis, level_likelihood, make_whitener
from calib.mismatch.noise.usual import usual_levels
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, fitted
from calib.types import FloatArray


def refine_last(
    rows: Rows,
    accepted: list[Accepted],
    levels: FloatArray,
    contrast: FloatArray,
    *,
    reference: bool,
) -> Accepted:
    """Refine the shape parameters of the last accepted between the grid's values."""
    last = accepted[-1]
    if has_ends(last.candidate) or last.candidate.name == THROUGHOUT:
        whitener = make_whitener(rows, levels, contrast, fitted(rows, accepted[:-1]))
        y = whitener.project(rows.residual)
        if last.candidate.name == THROUGHOUT:
            candidate, columns = tune_wave(rows, last.candidate, whitener, y)
        else:
            told = _told(rows, accepted, levels, contrast, Told(whitener, y))
            candidate = place_window(rows, last.candidate, *told)
            slipped = angle_of(candidate) is not None
            columns = (slip_columns if slipped else window_columns)(rows, candidate)
        number = columns.shape[1]
        return replace(
            last,
            candidate=candidate,
            columns=columns,
            typical=np.ones(number),
            values=np.zeros(number),
        )
    if not last.candidate.physical or not last.candidate.shape:
        return last
    whitener = make_whitener(rows, levels, contrast, fitted(rows, accepted[:-1]))
    y = whitener.project(rows.residual)
    candidate, columns = refined(
        rows, last.candidate, last.columns, whitener, y, reference=reference
    )
    return replace(last, candidate=candidate, columns=columns)


def _told(
    rows: Rows, accepted: list[Accepted], levels: FloatArray, contrast: FloatArray, told: Told
) -> list[Told]:
    """Return what rows tell of the last accepted: with the drift that was found, and the usual.

    Of a disturbance that comes and goes, the part that is fitted need not be all that raises it.
    """
    usual = usual_levels(rows, levels, accepted[-1].candidate.channels)
    if usual is None:
        return [told]
    mean = fitted(rows, accepted[:-1])
    basis = level_basis(rows, mean)
    cost = level_likelihood(rows, basis, usual) - level_likelihood(rows, basis, levels)
    whitener = make_whitener(rows, usual, contrast, mean)
    return [told, Told(whitener, whitener.project(rows.residual), cost)]


def refined(
    rows: Rows,
    candidate: Candidate,
    columns: FloatArray,
    whitener: Whitener,
    y: FloatArray,
    *,
    reference: bool,
) -> tuple[Candidate, FloatArray]:
    """Return the candidate and its columns at that shape near its own which explains most."""
    effect = get_effect(candidate.name)

    def gain(columns: FloatArray) -> float:
        return likelihood_gain(whitener.project(columns), y, present=candidate.present)

    best, value = (candidate, columns), gain(columns)

    def try_shape(shape: dict[str, float]) -> float:
        nonlocal best, value
        tried = candidate_columns(rows, candidate, shape, reference=reference)
        if tried is None:
            return -np.inf
        new = gain(tried)
        if new > value:
            best, value = (replace(candidate, shape=shape), tried), new
        return new

    for form in forms(effect, candidate.shape):
        for shape in neighbours(effect, rows, form):
            try_shape(shape)
    if effect.from_moment:
        for shape in neighbours(effect, rows, best[0].shape, closer=True):
            try_shape(shape)
        if not isinstance(effect, TransformEffect):
            # Of samples it is one of them; a mean at rest tells how much of it came after.
            placed = best[0].shape
            length = float(np.ptp(rows.interval[rows.segment_at(placed["moment"])]))

            def try_moment(moment: float) -> float:
                return try_shape({**placed, "moment": moment})

            close_in(try_moment, placed["moment"], value, length / (NEAR - 1) ** 2)
    # How strong a filter is is in its shape alone, whatever its form. And of what settles in a time
    # that is near to its own, enough is left to look like something that follows temperature.
    sizes = [i for i in effect.shape if i.spacing == "log" and i.name in candidate.shape]
    for shape in forms(effect, best[0].shape) if candidate.present else [dict(best[0].shape)]:
        for item in sizes:
            within = (0.0, np.inf)
            if not candidate.present:
                # What lasts much longer than the recording is a straight line, however long.
                grid = shape_grid(item, rows, SHAPES)
                within = float(grid[0]), float(grid[-1])
            _climb(try_shape, shape, item.name, within)
    return best


def _climb(
    gain: Callable[[dict[str, float]], float],
    shape: dict[str, float],
    name: str,
    within: tuple[float, float],
) -> None:
    """Call `gain` with values of one shape parameter in a range, closing in on its maximum."""
    low, high = within
    step, here, value = 0.08, shape[name], gain(shape)
    while step > 1e-4:
        beside = [x for x in (here * (1 + step), here / (1 + step)) if low <= x <= high]
        new, at = max(((gain({**shape, name: x}), x) for x in beside), default=(-np.inf, here))
        if new > value:
            value, here = new, at
        else:
            step /= 3


def likelihood_gain(columns: FloatArray, y: FloatArray, *, present: bool = False) -> float:
    """Return the log-likelihood that whitened columns gain at their best fit, or as they are."""
    if present:
        return float((columns.T @ y)[0] - 0.5 * np.square(columns).sum())
    fit = columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    return 0.5 * float(fit @ fit)
