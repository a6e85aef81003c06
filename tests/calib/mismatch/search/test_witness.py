"""Witnesses of an effect: one turn that samples do not resolve is none."""

import numpy as np
import pytest

from calib.effects.accel_settling import NONE, WHOLE
from calib.mismatch.hypotheses.families import candidate_columns
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.rows.rows import Kind
from calib.mismatch.search.accepted import contrast_noise, fitted
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.witness import shows_its_own, told_by_one_turn

from ..bench import problem


@pytest.fixture(scope="module")
def case():
    """Rows of a recording, the columns of an effect, and its turns by how much each shows of it."""
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    (found,) = (c for c in stack if c.name == "accel_size_effect" and len(c.index) == 6)
    columns = stack.of(found)
    size = np.bincount(rows.segment, np.square(columns).sum(axis=1) * (rows.kind == Kind.VELOCITY))
    return rows, columns, int(np.argmax(size))


def levels(rows, times):
    unresolved = np.array([c.name.endswith(" by sampling") for c in rows.components])
    return np.where(unresolved, times, 1.0) * expected_levels(rows)


def judged(rows, columns, off, times):
    at = levels(rows, times)
    whitener = make_whitener(rows, at, contrast_noise(rows, []), fitted(rows, []))
    # Ten times what noise alone does to the row that is farthest off.
    off = 10 * off / np.abs(whitener.project(off)).max()
    return told_by_one_turn(rows, columns, at, whitener, whitener.project(off))


def test_one_turn_that_samples_do_not_resolve_is_no_witness(case):
    rows, columns, turn = case
    sizes = np.array([1.0, -1.0, 0.5, 1.0, 0.5, -1.0])
    there = (rows.segment == turn)[:, None]
    # Of something that is large in one turn only, that turn is off.
    one = columns * np.where(there, 1.0, 0.03)
    off = np.where(there, one, 0.0) @ sizes
    assert judged(rows, one, off, 1e3)
    # Where samples resolve it, it is a witness; and so are all turns of what all show.
    assert not judged(rows, one, off, 1e-3)
    assert not judged(rows, columns, columns @ sizes, 1e3)


@pytest.mark.parametrize("settles", [True, False])
def test_a_bias_while_it_turns_and_no_longer_is_no_settling(settles):
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    settling = [c for c in stack if c.name == "accel_settling" and c.parameters == ("kz",)]
    whole = [c for c in settling if c.shape["in_turns"] == WHOLE]
    found = min(whole, key=lambda c: abs(c.shape["tau"] - 2.0))
    fades = candidate_columns(rows, found, {**found.shape, "in_turns": NONE}, reference=False)
    at = expected_levels(rows)
    whitener = make_whitener(rows, at, contrast_noise(rows, []), fitted(rows, []))
    left = whitener.project(stack.of(found) - (0.0 if settles else fades))[:, 0]
    left *= 10.0 / np.linalg.norm(left)
    assert shows_its_own(rows, stack, found, whitener, left) == settles
