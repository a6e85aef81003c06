"""A delay and a low-pass that come equally late, however late that is."""

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import accept
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.whole import whole_fit, whole_odds
from calib.mismatch.twin.selfmode import SelfProblem
from calib.statics import find_poses

from ..bench import GRAVITY, recording

TIE = {"mimicked": 9.0, "least": 0.02}


def late(delay: float) -> Term:
    return Term("time_offset", {"gyro_delay": delay})


def low_pass(triad: str, cutoff: float, order: int) -> Term:
    return Term("bandwidth", {f"{triad}_cutoff": cutoff, "order": order})


def problem(effect: str, *values: float | str) -> tuple[SelfProblem, Rows, Stack]:
    term = late(*values) if effect == "late" else low_pass(*values)
    real = recording(term, poses=18, rate=100.0)
    grid = make_grid(real, find_poses(real))
    self_mode = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    rows = self_mode.rows()
    return self_mode, rows, make_stack(rows, skip=(), reference=False)


def candidate(stack: Stack, name: str, parameter: str) -> Candidate:
    return next(c for c in stack if c.name == name and c.parameters == (parameter,))


@pytest.mark.long
@pytest.mark.parametrize("delay", [-0.05, 0.02])
def test_a_late_gyroscope_is_named_alone(delay: float) -> None:
    found = diagnose_recording(recording(late(delay), seed=6), gravity=GRAVITY)
    assert not found.unexplained
    (finding,) = found.findings
    assert finding.effect == "time_offset"
    q = finding.parameters["gyro_delay"]
    assert q.sigma is not None
    assert q.sigma < 2e-4
    assert q.value == pytest.approx(delay, abs=3 * q.sigma)


@pytest.mark.parametrize(
    ("truth", "guess"),
    [
        (("late", 0.03), ("bandwidth", "gyro")),
        (("late", -0.03), ("time_offset", "gyro_delay")),
        (("late", -0.03), ("bandwidth", "gyro")),
    ],
)
def test_a_delay_is_found_whatever_was_guessed(
    truth: tuple[str, float], guess: tuple[str, str]
) -> None:
    self_mode, rows, stack = problem(*truth)
    start = accept(stack, candidate(stack, *guess), 100.0)
    fit = whole_fit(self_mode, rows, stack, [], start, expected_levels(rows))
    assert fit is not None
    (found,) = fit.accepted
    assert found.candidate.name == "time_offset"
    assert found.in_model
    np.testing.assert_allclose(found.values, truth[1], atol=3e-4)
    # It is no longer in the rows, and its column is that of a little more of it.
    turns = rows.kind >= Kind.ATTITUDE
    left = np.linalg.norm(fit.rows.residual[turns])
    assert left < 0.05 * np.linalg.norm(rows.residual[turns])
    np.testing.assert_allclose(self_mode.rows().residual, fit.rows.residual, atol=1e-12)
    own = stack.of(found.candidate)[:, 0]
    assert 0.0 < np.linalg.norm(found.columns[:, 0] - own) < 0.5 * np.linalg.norm(own)


@pytest.mark.parametrize("guess", [("time_offset", "gyro_delay"), ("bandwidth", "accel")])
@pytest.mark.parametrize("order", [1, 2])
def test_a_low_pass_is_found_whatever_was_guessed(order: int, guess: tuple[str, str]) -> None:
    self_mode, rows, stack = problem("low-pass", "accel", 4.0, order)
    start = accept(stack, candidate(stack, *guess), 100.0)
    fit = whole_fit(self_mode, rows, stack, [], start, expected_levels(rows))
    assert fit is not None
    (found,) = fit.accepted
    assert found.candidate.name == "bandwidth"
    assert not found.in_model
    assert found.candidate.shape["order"] == order
    assert found.candidate.shape["accel_cutoff"] == pytest.approx(4.0, rel=0.01)


def test_a_delay_that_is_straight_is_left_to_its_column() -> None:
    self_mode, rows, stack = problem("late", 0.001)
    start = accept(stack, candidate(stack, "time_offset", "gyro_delay"), 100.0)
    levels = expected_levels(rows)
    assert whole_fit(self_mode, rows, stack, [], start, levels) is None
    assert whole_odds(self_mode, rows, stack, [start], 0, levels, **TIE) is start


def test_nothing_else_is_taken_for_a_delay() -> None:
    self_mode, rows, stack = problem("late", 0.03)
    levels = expected_levels(rows)
    own = candidate(stack, "time_offset", "gyro_delay")
    skew = candidate(stack, "inter_axis_skew", "gyro_y")
    first, start = (accept(stack, c, 100.0) for c in (own, skew))
    assert whole_fit(self_mode, rows, stack, [], start, levels) is None
    # Nor is a second one looked for.
    assert whole_fit(self_mode, rows, stack, [first], first, levels) is None


@pytest.mark.parametrize(("delay", "tied"), [(0.008, True), (0.06, False)])
@pytest.mark.long
def test_a_low_pass_is_as_likely_as_a_short_delay(delay: float, tied: bool) -> None:
    self_mode, rows, stack = problem("late", delay)
    start = accept(stack, candidate(stack, "time_offset", "gyro_delay"), 100.0)
    fit = whole_fit(self_mode, rows, stack, [], start, expected_levels(rows))
    assert fit is not None
    found = whole_odds(self_mode, fit.rows, stack, fit.accepted, 0, fit.levels, **TIE)
    assert set(found.posterior) == {"time_offset", "bandwidth"}
    assert sum(found.posterior.values()) == pytest.approx(1.0)
    assert (min(found.posterior.values()) >= TIE["least"]) == tied
    # What was taken out of the rows stays so.
    np.testing.assert_allclose(self_mode.rows().residual, fit.rows.residual, atol=1e-12)
