"""Twins: what a recording cannot tell from a finding."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects import get_effect
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.families import effect_columns
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import Accepted, fitted
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.twins import HEADING, MIMICKED, STRAIGHT, turns_about_up, twins

from ..bench import GRAVITY, problem, recording

AXES = ("kx", "ky", "kz")


@pytest.mark.parametrize("beyond", [False, True])
def test_a_twin_mimics_a_shape_that_is_within_two_standard_errors(beyond, monkeypatch):
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    warm = [c for c in stack if c.name == "gyro_warm_up" and c.parameters == AXES]
    candidate = min(warm, key=lambda c: abs(c.shape["tau"] - 60.0))
    rate = effect_columns(get_effect("gyro_temperature_rate"), rows, {}, reference=False)
    twin = whitener.project(np.stack([rate[k] for k in AXES], axis=1))
    own = whitener.project(stack.of(candidate))
    # The twin is what is there, and a drift beside it goes along with another shape by chance.
    true = twin[:, 2] / np.linalg.norm(twin[:, 2])
    chance = own[:, 2] - twin @ np.linalg.lstsq(twin, own[:, 2], rcond=None)[0]
    y = 20.0 * true + np.sqrt(MIMICKED) * chance / np.linalg.norm(chance)
    if beyond:
        monkeypatch.setattr("calib.mismatch.search.twins.ALLOWED", 0.0)
    found = Accepted(candidate, stack.of(candidate), np.ones(3), np.zeros(3), False, 100.0)
    evidence = stack.log_bayes_factors(whitener, y)
    names = twins(rows, stack, found, evidence, whitener, y, reference=False)
    assert ("gyro_temperature_rate" in names) is not beyond
    assert "gyro_scale_nonlinearity" not in names


def test_the_fullest_candidate_of_an_effect_is_compared_and_not_its_best_alone():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    own = next(c for c in stack if c.name == "accel_bias_temperature" and c.parameters == AXES)
    slower = [c for c in stack if c.name == "accel_warm_up" and c.parameters == AXES]
    columns = whitener.project(stack.of(max(slower, key=lambda c: c.shape["tau"])))
    y = columns @ (np.array([20.0, 4.0, 4.0]) / np.linalg.norm(columns, axis=0))
    evidence = stack.log_bayes_factors(whitener, y) + stack.weight
    # What few parameters explain nearly as well counts for more, and what is left is judged alone.
    alone = [c.name == "accel_warm_up" and c.parameters == ("kx",) for c in stack]
    evidence[alone] = evidence.max() + 1.0
    found = Accepted(own, stack.of(own), np.ones(3), np.zeros(3), False, 100.0)
    assert "accel_warm_up" in twins(rows, stack, found, evidence, whitener, y, reference=False)


@pytest.mark.parametrize("north", [0.0, 1.0])
def test_what_a_known_rival_mimics_wholly_is_a_tie_however_many_parameters_it_has(north):
    """The Earth's rotation about the vertical is a g-sensitivity that is alike on all axes."""
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    candidate = next(c for c in stack if c.name == "earth_rate")
    if not north:
        candidate = replace(candidate, parameters=("up",), index=candidate.index[2:])
    columns = stack.of(candidate)
    white = whitener.project(columns)
    y = 12.0 * white[:, -1] / np.linalg.norm(white[:, -1])
    if north:
        y = y + 12.0 * white[:, 1] / np.linalg.norm(white[:, 1])
    found = Accepted(
        candidate, columns, np.ones(columns.shape[1]), np.zeros(columns.shape[1]), False, 100.0
    )
    evidence = stack.log_bayes_factors(whitener, y)
    names = twins(rows, stack, found, evidence, whitener, y, reference=False)
    assert ("gyro_g_sensitivity" in names) is (not north)


@pytest.mark.long
def test_what_hardly_shows_has_no_twins():
    """Within the noise everything is alike: thirty effects were rivals of one that had faded."""
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    own = next(c for c in stack if c.name == "gyro_scale_nonlinearity" and c.parameters == AXES)
    columns = stack.of(own)
    along = whitener.project(columns) @ np.ones(3)
    y = 2.0 * along / np.linalg.norm(along)
    found = Accepted(own, columns, np.ones(3), np.zeros(3), False, 100.0)
    evidence = stack.log_bayes_factors(whitener, y)
    names = twins(rows, stack, found, evidence, whitener, y, reference=False)
    assert len(names) < 6
    assert "accel_warm_up" not in names


@pytest.mark.parametrize(
    ("sizes", "reference", "other"),
    [
        ((6e-6, 6e-6, 6e-6), False, "earth_rate"),
        ((6e-6, 6e-6, 6e-6), True, "earth_rate"),
        ((2e-5, 2e-5, 2e-5), False, None),
        ((2e-5, 2e-5, 2e-5), True, HEADING),
        ((6e-6, -6e-6, 6e-6), False, None),
    ],
)
def test_a_g_sensitivity_of_all_axes_alike_turns_about_the_vertical(sizes, reference, other):
    """As the Earth does at its rate, and a reference that drifts in heading at any."""
    _, made = problem()
    rows = made.rows()
    names = ("gxx", "gyy", "gzz")
    found = effect_columns(get_effect("gyro_g_sensitivity"), rows, {}, reference=False)
    columns = np.stack([found[n] for n in names], axis=1)
    stack = make_stack(rows, skip=(), reference=False)
    candidate = next(c for c in stack if c.name == "gyro_g_sensitivity")
    candidate = replace(candidate, parameters=names)
    typical = np.full(3, get_effect("gyro_g_sensitivity").parameters[0].typical)
    own = Accepted(candidate, columns, typical, np.zeros(3), False, 100.0)
    quiet = 1e-3 * np.sqrt(rows.white_diagonal), 1e-3 * expected_levels(rows)
    whitener = make_whitener(rows, quiet[1], np.square(quiet[0]), fitted(rows, []))
    y = whitener.project(columns @ (np.array(sizes) / typical))
    said = turns_about_up(own, whitener, y, gravity=rows.state.gravity, reference=reference)
    assert said == other


@pytest.mark.parametrize(("tau", "straight"), [(900.0, True), (12.0, False)])
def test_what_has_not_settled_is_no_other_than_drift_in_a_straight_line(
    tau: float, straight: bool
) -> None:
    size = 0.05 if straight else 0.005
    real = recording(Term("gyro_warm_up", {"kx": size, "tau": tau}), poses=16)
    found = diagnose_recording(replace(real, temperature=None), gravity=GRAVITY)
    (named,) = found.findings
    assert named.effect == "gyro_warm_up"
    assert (STRAIGHT in {rival.effect for rival in named.rivals}) == straight
    assert ("has not settled" in named.sentence) == straight
