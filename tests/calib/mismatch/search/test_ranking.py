"""What all candidates are worth, and when that is enough to say something."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.noise.noise import (
    NEAR,
    estimate_levels,
    expected_levels,
    level_basis,
    level_likelihood,
)
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.search.accepted import accept, fitted
from calib.mismatch.search.ranking import (
    CLAIM,
    PLAIN,
    _running,
    chance,
    make_stack,
    rank,
)
from calib.mismatch.twin.selfmode import SelfProblem
from calib.statics import find_poses

from ..bench import GRAVITY, recording
from .stacked import candidate


def test_a_p_value_is_no_less_rare_than_evidence_of_noise():
    # Of 10000 draws of known noise 24 reach the claim (`benchmarks/evidence.py`), of clean
    # recordings 5 of 800 (`concealed.py --parts clean`).
    assert 24 / 10000 < 5 / 800 < chance(CLAIM) < 0.01
    assert chance(1e-3) == 1.0


def test_something_is_claimed_where_all_that_may_be_left_reaches_the_claim(stacked):
    rows, stack = stacked
    plain = rank(rows, stack, [], expected_levels(rows))
    half = float(np.log(CLAIM / 2))
    assert replace(plain, groups={"this": half + 0.01, "that": half + 0.01}).claims
    assert not replace(plain, groups={"this": half - 0.01, "that": half - 0.01}).claims
    assert not replace(plain, groups={}).claims


def test_levels_with_all_physics_are_where_they_were_before(stacked):
    rows, stack = stacked
    first = rank(rows, stack, [], expected_levels(rows))
    again = rank(rows, stack, [], expected_levels(rows), every=first.every)
    assert again.every == pytest.approx(first.every, rel=0.2)
    near = first.evidence > first.evidence.max() - 1.0
    assert again.evidence[near] == pytest.approx(first.evidence[near], abs=0.1)


def test_a_plain_step_is_looked_at_closer_however_far_something_else_is_ahead():
    scale = Candidate("scale", np.arange(1), 0.1, True, ("accel.x",), parameters=("kx",))
    step, window = replace(scale, shape={"moment": 3.0}), replace(scale, physical=False)
    best = {"step": step, "window": window, "scale": scale, "late": step}
    groups = {"window": 200.0, "scale": 100.0, "step": 40.0, "late": 15.0}
    assert set(_running(best, groups)) == {"window", "step"}
    assert set(_running(best, {g: 0.1 * v for g, v in groups.items()})) == set(groups)


def test_a_fit_starts_from_levels_that_were_found_beside_what_is_fitted():
    strong = Term("gyro_g_sensitivity", {"gxx": 1e-3, "gyy": -1e-3, "gzx": 1e-3})
    real = recording(strong)
    grid = make_grid(real, find_poses(real))
    rows = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).rows()
    stack = make_stack(rows, skip=(), reference=False)
    ranking = rank(rows, stack, [], expected_levels(rows))
    top = max(ranking.groups, key=lambda g: ranking.groups[g])
    assert top == "gyro_g_sensitivity"
    chosen = ranking.best[top]
    mean = np.hstack((fitted(rows, []), stack.of(chosen)))
    basis = level_basis(rows, mean)
    beside = level_likelihood(rows, basis, ranking.levels_with(chosen))
    assert beside > estimate_levels(rows, mean, ranking.levels).log_likelihood - 2 * NEAR
    assert beside > level_likelihood(rows, basis, ranking.levels) + 10.0
    # What is far behind is not looked at so closely.
    assert ranking.groups[top] > PLAIN
    behind = [c for g, c in ranking.best.items() if ranking.groups[g] < 0]
    assert behind
    for other in behind:
        assert ranking.levels_with(other) is ranking.levels


def test_what_is_fitted_in_full_is_worth_what_it_is_beforehand(stacked):
    """No drift makes it show, so that none is found for it; beside a part of it one is."""
    rows, stack = stacked
    axes = ("kx", "ky", "kz")
    whole, part = (candidate(stack, "accel_cubic", names) for names in (axes, axes[:1]))
    full, more = (
        rank(rows, stack, [accept(stack, c, 1.0)], expected_levels(rows)) for c in (whole, part)
    )
    own = [c.weight for c in stack.physics.values() if c.name == whole.name]
    assert full.groups[whole.name] == pytest.approx(np.log(sum(own)), abs=1e-5)
    assert whole.name not in full.beside
    assert whole.name in more.beside


def test_levels_that_are_known_are_not_looked_for_again(stacked):
    rows, stack = stacked
    taken, start = (
        accept(stack, candidate(stack, "accel_cubic", ("kx",)), 1.0),
        expected_levels(rows),
    )
    base = estimate_levels(rows, fitted(rows, [taken]), start)
    known, found = rank(rows, stack, [taken], start, base=base), rank(rows, stack, [taken], start)
    assert known.levels is base.values
    assert known.groups == pytest.approx(found.groups, rel=1e-9)
