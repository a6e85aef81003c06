"""Two steps that cancel are one disturbance; others are steps."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.estimate import Estimate
from calib.mismatch.search.returned import returned


def _step(name: str, axes: str, moment: float) -> Accepted:
    triad = name.partition("_")[0]
    candidate = Candidate(
        name,
        np.arange(len(axes)),
        0.1,
        True,
        tuple(f"{triad}.{a}" for a in axes),
        parameters=tuple(f"b{a}" for a in axes),
        shape={"moment": moment},
    )
    none = np.zeros((4, len(axes)))
    return Accepted(candidate, none, np.full(len(axes), 0.01), np.zeros(len(axes)), False, 1e9)


def _fit(values: list[float], at: tuple[int, ...], together: float = 0.0) -> Estimate:
    spread = 0.02**2 * ((1 - together) * np.eye(len(values)) + together)
    told = np.ones(len(values), bool)
    return Estimate(np.array(values), spread, at, {}, {}, {}, np.zeros(4), told)


@pytest.mark.parametrize(
    ("second", "together", "gone"),
    [(-2.03, 0.0, True), (-1.8, 0.0, False), (2.0, 0.0, False), (-2.06, -0.9, False)],
)
def test_a_step_that_goes_back_was_a_window(second: float, together: float, gone: bool) -> None:
    steps = [_step("accel_bias_step", "z", 40.0), _step("accel_bias_step", "z", 20.0)]
    # The first parameter is of the baseline.
    found = returned(_fit([0.3, 2.0, second], (1, 2, 3), together), steps)
    assert found == ({0: (20.0, 40.0), 1: (20.0, 40.0)} if gone else {})


def test_both_must_be_of_one_triad_and_all_of_its_axes_go_back() -> None:
    x = _step("gyro_bias_step", "x", 10.0)
    other = _step("accel_bias_step", "x", 20.0)
    assert returned(_fit([2.0, -2.0], (0, 1, 2)), [x, other]) == {}
    both = _step("gyro_bias_step", "xy", 20.0)
    assert returned(_fit([2.0, -2.0, 0.01], (0, 1, 3)), [x, both]) == {
        0: (10.0, 20.0),
        1: (10.0, 20.0),
    }
    assert returned(_fit([2.0, -2.0, 0.5], (0, 1, 3)), [x, both]) == {}


def test_a_step_has_one_way_back() -> None:
    steps = [_step("gyro_bias_step", "y", t) for t in (10.0, 20.0, 30.0)]
    assert set(returned(_fit([2.0, -2.0, 2.0], (0, 1, 2, 3)), steps)) == {0, 1}


def test_two_weak_steps_of_unlike_size_are_steps() -> None:
    """Their sum is three standard errors: noise reaches that, and two steps far more often."""
    steps = [_step("gyro_bias_step", "y", t) for t in (10.0, 20.0)]
    assert returned(_fit([0.18, -0.10], (0, 1, 2)), steps) == {}
    assert set(returned(_fit([0.18, -0.16], (0, 1, 2)), steps)) == {0, 1}
