"""Candidates as answers: no evidence is lost, and what is near is between places of the grid."""

import numpy as np
import pytest
from scipy.special import logsumexp

from calib.mismatch.hypotheses.answers import (
    LEADERS,
    _add_at,
    _average,
    evidence_near,
    grouped,
    leading,
    nearby,
)
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import make_stack

from ..bench import problem


@pytest.fixture(scope="module")
def stacked():
    _, self_mode = problem()
    rows = self_mode.rows()
    return rows, make_stack(rows, skip=(), reference=False)


def test_groups_hold_all_of_the_evidence(stacked):
    _, stack = stacked
    evidence = np.random.default_rng(3).normal(size=len(stack), scale=5.0)
    best, groups = grouped(stack, evidence)
    assert logsumexp(list(groups.values())) == pytest.approx(logsumexp(evidence))
    for name, candidate in best.items():
        own = [e for e, c in zip(evidence, stack, strict=True) if c.group == name]
        assert evidence[stack.index(candidate)] == max(own)


def test_leaders_are_the_best_of_physics_and_of_rivals(stacked):
    _, stack = stacked
    evidence = np.random.default_rng(4).normal(size=len(stack))
    best, groups = grouped(stack, evidence)
    found = leading(best, groups)
    for physical, count in zip((True, False), LEADERS, strict=True):
        own = [groups[g] for g in groups if best[g].physical is physical]
        led = [groups[g] for g in found if best[g].physical is physical]
        assert led == sorted(own, reverse=True)[:count]


@pytest.mark.parametrize("name", ["gyro_warm_up", "gyro_bias_step", "wave in a window"])
def test_a_place_between_those_of_the_grid_is_near_one(stacked, name):
    rows, stack = stacked
    own = [c for c in stack if c.name == name]
    leader = own[len(own) // 2]
    near = nearby(rows, leader)
    assert len(near) >= 3
    assert {c.group for c in near} == {leader.group}
    here = stack.of(leader)
    apart = [np.linalg.norm(near.of(c) - here) / np.linalg.norm(here) for c in near]
    assert 0.0 < np.median(apart) < 2.0


def test_what_has_no_place_has_nothing_near(stacked):
    rows, stack = stacked
    leader = next(c for c in stack if c.name == "gyro_g_sensitivity")
    assert not len(nearby(rows, leader))


def test_a_moment_counts_as_that_of_the_rest_or_turn_that_says_most(stacked):
    rows, stack = stacked
    own = [c for c in stack if c.name == "gyro_bias_step" and c.is_single]
    near = nearby(rows, own[len(own) // 2])
    moments = np.array([c.shape["moment"] for c in near])
    place = np.searchsorted(rows.interval[:, 0], moments, side="right")
    assert len(np.unique(place)) == 3
    for k in np.unique(place):
        factors = np.where(place == k, 5.0, -40.0)
        assert _average(rows, near, factors) == pytest.approx(5.0)


@pytest.mark.parametrize("name", ["gyro_warm_up", "gyro_bias_step"])
@pytest.mark.parametrize("size", [1.0, 300.0])
def test_strong_evidence_counts_about_its_peak(stacked, name, size):
    """At size 300 the peak is hundreds of times narrower than the places that are tried."""
    rows, stack = stacked
    own = [c for c in stack if c.name == name and c.is_single]
    near = nearby(rows, own[len(own) // 2])
    key = "tau" if name == "gyro_warm_up" else "moment"
    between = 0.37 * near[1].shape[key] + 0.63 * near[2].shape[key]
    there = Stack(len(rows.residual))
    _add_at(there, rows, near[1], {**near[1].shape, key: between})
    levels = expected_levels(rows)
    whitener = make_whitener(rows, levels, contrast_variance(rows), fitted(rows, []))
    (true,) = there
    white = whitener.project(there.of(true))[:, 0]
    y = size * 3.0 * white / np.linalg.norm(white)
    most = there.log_bayes_factors(whitener, y)[0]
    found = evidence_near(rows, near, whitener, y)
    assert found <= most + 1.0
    if size > 1.0:
        assert found > most - 0.5 * np.log(2 * most) - 1e-3 * most
        assert found > _average(rows, near, near.log_bayes_factors(whitener, y))


def test_a_group_of_no_evidence_is_no_answer(stacked):
    _, stack = stacked
    evidence = np.where(stack.physical, 1.0, -np.inf)
    best, groups = grouped(stack, evidence)
    assert best.keys() == groups.keys() == {c.group for c in stack.physics.values()}
