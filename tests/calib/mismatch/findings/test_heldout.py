"""Held-out blocks: what is foretold of them, and how sure."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.findings.heldout import FOLDS, _gain, fold_of, held_out, leave_out
from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import fitted
from calib.types import FloatArray

from ..bench import problem

WIDE = 1e5
"""Standard deviations of noise that parameters may be off by: nothing is known of them."""


def covariance(rows: Rows, levels: FloatArray) -> FloatArray:
    out = np.diag(np.concatenate((np.zeros(rows.n_dense), rows.white_diagonal)))
    out[: rows.n_dense, : rows.n_dense] += rows.white
    for level, c in zip(levels, rows.components, strict=True):
        out[np.ix_(c.index, c.index)] += level * c.matrix
    return out


def log_density(y: FloatArray, spread: FloatArray) -> float:
    root = np.linalg.cholesky(spread)
    white = np.linalg.solve(root, y)
    return float(-0.5 * white @ white - np.log(np.diagonal(root)).sum())


def foretold(rows: Rows, mean: FloatArray, y: FloatArray, levels: FloatArray) -> float:
    """Return the log-density of each block given all others, summed over the blocks."""
    noise = covariance(rows, levels)
    # In units of each row's noise, columns of unit length: numbers that can be inverted.
    scale = np.sqrt(np.diag(noise))
    columns = mean / scale[:, None]
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    spread = noise / np.outer(scale, scale) + WIDE**2 * columns @ columns.T
    fold, y = fold_of(rows), y / scale
    total = 0.0
    for k in range(FOLDS):
        seen = fold != k
        total += log_density(y, spread) - log_density(y[seen], spread[np.ix_(seen, seen)])
    return total


@pytest.mark.parametrize("size", [0.0, 8.0])
def test_a_gain_is_what_blocks_are_more_probable_by_and_counts_how_vague_a_fit_is(size: float):
    _, made = problem()
    rows = made.rows()
    levels, mean = expected_levels(rows), fitted(rows, [])
    rng = np.random.default_rng(4)
    noise = covariance(rows, levels)
    root = np.linalg.cholesky(noise)
    column = rng.normal(size=(len(noise), 3)) * np.sqrt(np.diag(noise))[:, None]
    y = root @ rng.normal(size=len(noise)) + column[:, 0] * size / np.sqrt(len(noise))
    found = held_out(
        rows,
        mean,
        column,
        y,
        levels=levels,
        contrast=rows.white_diagonal,
        channels=("gyro.x",),
    )
    after = np.hstack((mean, column))
    truth = foretold(rows, after, y, levels) - foretold(rows, mean, y, levels)
    assert found.gain == pytest.approx(truth, abs=0.05)
    assert (found.gain > 0) is (size > 0)


def test_what_the_fit_of_all_findings_says_may_be_known() -> None:
    """In whatever order its columns are: beside several findings it is the same."""
    _, made = problem()
    rows = made.rows()
    rng = np.random.default_rng(5)
    mean, column = fitted(rows, []), rng.normal(size=(len(rows.residual), 2))
    noise = {"levels": expected_levels(rows), "contrast": rows.white_diagonal}
    after = leave_out(rows, np.hstack((column, mean)), rows.residual, **noise)
    known, found = (
        held_out(rows, mean, column, rows.residual, **noise, channels=("gyro.x",), after=given)
        for given in (after, None)
    )
    assert known.gain == pytest.approx(found.gain, rel=1e-6)
    assert known[:3] == pytest.approx(found[:3], rel=1e-6)
    assert known[3:5] == found[3:5]


def test_what_one_block_hardly_foretells_has_a_density_all_the_same() -> None:
    """Its covariance has more digits than a number: the square of it is singular."""
    pull, turn = np.array([2e9, 3.0]), np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    vague, sure = np.array([1e18, 1.0]), np.array([0.5, 0.25])
    _, made = problem()
    rows = made.rows()
    known = leave_out(
        rows,
        fitted(rows, []),
        rows.residual,
        levels=expected_levels(rows),
        contrast=rows.white_diagonal,
    )
    before, after = (
        known._replace(blocks=[(values, vectors, pull)])
        for values, vectors in ((vague, np.eye(2)), (sure, turn))
    )
    gain, errors = _gain(before, after)
    # Both foretell all directions: what is missed is p' inv(P) p, of the width det(P)^(-1/2).
    each = (vague, np.eye(2)), (sure, turn)
    missed = [float((np.square(v.T @ pull) / p).sum()) for p, v in each]
    width = [0.5 * float(np.log(p).sum()) for p in (vague, sure)]
    truth = 0.5 * (missed[0] - missed[1]) + width[1] - width[0]
    assert gain == pytest.approx(truth, rel=1e-9)
    assert errors == pytest.approx(np.sqrt(np.array(missed) / 2.0), rel=1e-7)
