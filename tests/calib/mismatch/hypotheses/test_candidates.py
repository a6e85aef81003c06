"""Candidates that are scored at once have the evidence of each alone."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.hypotheses.candidates import FLUCTUATING, SHARE, Bank, Candidate, narrowed
from calib.mismatch.hypotheses.factors import log_bayes_factor, log_bayes_factors
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.hypotheses.shared import with_shared
from calib.mismatch.hypotheses.windows import window_columns
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import make_stack

from ..bench import problem


def test_every_make_of_candidate_has_the_evidence_of_its_columns():
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=("accel_quadratic", "time"), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), contrast_variance(rows), fitted(rows, []))
    y = whitener.project(rows.residual)
    found = stack.log_bayes_factors(whitener, y)
    assert len(found) == len(stack)
    seen: dict[tuple[str, int, int], int] = {}
    for i, c in enumerate(stack):
        make = (c.name, len(c.channels), stack.of(c).shape[1])
        if seen.setdefault(make, 0) < 4 and i % 5 == 0 and not c.present:
            seen[make] += 1
            columns = whitener.project(stack.of(c))
            gram, match = columns.T @ columns, y @ columns
            alone = log_bayes_factors(
                gram[None], match[None], np.array([c.physical and not c.counted])
            )[0]
            if c.may_be_shared:
                alone = with_shared(np.array([alone]), gram[None], match[None])[0]
            assert found[i] == pytest.approx(alone, rel=1e-6, abs=1e-6), make
    assert len(seen) > 60
    assert not {"accel_quadratic", "time"} & {name for name, *_ in seen}


def test_some_candidates_are_scored_as_among_all():
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), contrast_variance(rows), fitted(rows, []))
    y = whitener.project(rows.residual)
    every = stack.log_bayes_factors(whitener, y)
    some = np.random.default_rng(1).random(len(every)) < 0.1
    triad = ("accel.x", "accel.y", "accel.z")
    for which in (some, stack.of_channels(triad, physical=False)):
        found = stack.log_bayes_factors(whitener, y, which=which)
        np.testing.assert_allclose(found[which], every[which], rtol=1e-9, atol=1e-9)
        assert (found[~which] == -np.inf).all()
    names, code = stack.groups()
    assert [names[k] for k in code] == [c.group for c in stack]
    np.testing.assert_allclose(np.exp(stack.weight), [c.weight for c in stack])
    own = [c.channels == triad and not c.physical for c in stack]
    np.testing.assert_array_equal(stack.of_channels(triad, physical=False), own)


def test_sorted_candidates_come_first():
    one = Candidate("one", np.array([0]), 0.5, True, ("accel.x",))
    stack = Stack(3)
    stack.extend(Bank([one]))
    stack.add(one)
    assert [len(bank) for bank in stack.banks] == [1, 1]
    with pytest.raises(ValueError, match="before single"):
        stack.extend(Bank([one]))


def test_candidates_of_one_channel_are_those_of_another_on_its_columns():
    known = [
        Candidate("one", np.array([0]), 0.25, False, ("accel.x",)),
        Candidate("two", np.array([0, 1]), 0.5, False, ("accel.x",), mixing=np.eye(2)),
        Candidate("three", np.array([1, 2]), 0.25, False, ("accel.x",), summed=True),
    ]
    there = Bank(known).moved(("gyro.y",), 4)
    np.testing.assert_array_equal(there.group, np.arange(3))
    assert there.groups == [c.group for c in there] == ["one gyro.y", "two gyro.y", "three gyro.y"]
    assert [c.index.tolist() for c in there] == [[4], [4, 5], [5, 6]]
    columns = [make.columns.tolist() for make in there.made(np.ones(3, bool))]
    assert columns == [[4], [4, 5, 6], [4, 5, 6]]


def test_a_candidate_has_a_number_and_one_that_is_none_of_them_has_not():
    _, self_mode = problem()
    stack = make_stack(self_mode.rows(), skip=(), reference=False)
    physics = stack.physics
    assert physics == {i: c for i, c in enumerate(stack) if c.physical}
    for i in (0, len(stack.banks[0]) + 7, *list(physics)[::99]):
        assert stack.index(stack[i]) == i
    with pytest.raises(ValueError, match="none of these"):
        stack.index(Candidate("one", np.array([0]), 0.5, True, ("accel.x",)))


def test_rivals_of_the_next_round_are_those_of_the_last():
    _, self_mode = problem()
    rows = self_mode.rows()
    first, second = (make_stack(rows, skip=(), reference=False) for _ in range(2))
    assert first.banks[0] is second.banks[0]
    other = make_stack(rows, skip=("time",), reference=False)
    assert other.banks[0] is not first.banks[0]


def test_more_combinations_than_columns_are_as_probable_as_few():
    rng = np.random.default_rng(5)
    columns, y = rng.normal(size=(20, 3)), rng.normal(size=20)
    wide, slim = rng.normal(size=(2, 3, 7)), rng.normal(size=(2, 3, 2))
    assert narrowed(slim) is slim
    few = narrowed(wide)
    assert few.shape == (2, 3, 3)
    for many, one in zip(wide, few, strict=True):
        expected = log_bayes_factor(columns @ many, y)
        assert log_bayes_factor(columns @ one, y) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("order", [28.0, 27.0])
def test_what_axes_share_has_the_evidence_of_one_course(order):
    """Its columns are no three courses side by side, be there three times as many or not."""
    _, self_mode = problem()
    rows = self_mode.rows()
    whitener = make_whitener(rows, expected_levels(rows), contrast_variance(rows), fitted(rows, []))
    y, triad = whitener.project(rows.residual), ("gyro.x", "gyro.y", "gyro.z")
    shape = {"order": order, "corner": 6.0, **dict(zip(SHARE, (0.6, 0.0, -0.8), strict=True))}
    span = float(rows.interval[2, 0]), float(rows.interval[15, 1])
    one = Candidate(FLUCTUATING, np.arange(0), 1.0, False, triad, shape=shape, interval=span)
    columns, stack = window_columns(rows, one), Stack(len(y))
    stack.add(replace(one, index=stack.columns.add(columns)))
    found = stack.log_bayes_factors(whitener, y)[0]
    assert columns.shape[1] == order
    assert found == pytest.approx(log_bayes_factor(whitener.project(columns), y), abs=1e-6)
