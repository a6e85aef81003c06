"""The search: one finding for one cause, however often the evidence comes back to it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from calib.effects import get_effect
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.rivals import FROM_START
from calib.mismatch.noise.noise import (
    NEAR,
    estimate_levels,
    expected_levels,
    level_likelihood,
    make_whitener,
    range_basis,
)
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.search import search
from calib.mismatch.search.ranking import (
    CLAIM,
    DRIFTING,
    PLAIN,
    Ranking,
    _swap,
    chance,
    fitted,
    make_stack,
    rank,
)
from calib.mismatch.search.search import (
    _accept,
    _again,
    _possible,
    _posterior,
    _with,
    choose,
)
from calib.mismatch.twin.selfmode import SelfProblem
from calib.recording import CHANNELS
from calib.statics import find_poses

from ..bench import GRAVITY, problem, recording


@pytest.fixture(scope="module")
def stacked():
    _, self_mode = problem()
    rows = self_mode.rows()
    return rows, make_stack(rows, skip=(), reference=False)


def candidate(stack, name, parameters):
    found = [c for c in stack if c.name == name and c.parameters == parameters]
    return found[len(found) // 2]


def test_parameters_of_one_effect_are_one_finding(stacked):
    rows, stack = stacked
    first = _accept(stack, candidate(stack, "gyro_warm_up", ("kz",)), 100.0)
    first.values[:] = 2e-3
    new = _accept(stack, candidate(stack, "gyro_warm_up", ("kx",)), 50.0)
    (both,) = _with(rows, [first], new, reference=False)
    assert both.candidate.parameters == ("kx", "kz")
    assert both.candidate.channels == ("gyro.x", "gyro.z")
    assert both.candidate.shape == first.candidate.shape
    np.testing.assert_array_equal(both.values, [0.0, 2e-3])
    np.testing.assert_allclose(both.columns[:, 1:], first.columns)
    assert _again(candidate(stack, "gyro_warm_up", ("kx",)), [both])
    assert not _again(candidate(stack, "gyro_warm_up", ("ky",)), [both])


def test_events_of_one_kind_stay_apart(stacked):
    rows, stack = stacked
    steps = [c for c in stack if c.name == "gyro_bias_step" and len(c.index) == 1]
    first, new = (_accept(stack, c, 100.0) for c in (steps[0], steps[9]))
    assert len(_with(rows, [first], new, reference=False)) == 2
    assert not _again(steps[0], [first])


def ranked(stacked, evidence, drifting=frozenset()):
    rows, stack = stacked
    best = {c.group: c for c in evidence}
    groups = {c.group: value for c, value in evidence.items()}
    levels = expected_levels(rows)
    return Ranking(stack, np.zeros(0), best, groups, levels, drifting)


def wave_in_a_window(stack, channel):
    return next(c for c in stack if c.group == f"wave in a window {channel}")


def test_what_a_drift_can_mimic_is_not_passed_over_for_a_poorer_rival(stacked):
    rows, stack = stacked
    step = candidate(stack, "gyro_bias_step", ("bz",))
    wave = wave_in_a_window(stack, "gyro.z")

    def chosen(of_step, of_wave):
        found = ranked(stacked, {step: of_step, wave: of_wave}, frozenset({step.group}))
        return choose(rows, found, [])

    assert chosen(3.8, -0.2) is step
    assert chosen(1.5, -0.2) is None
    assert chosen(1.5, 1.5) is wave
    assert chosen(6.0, 2.0) is step
    # Both together are enough, but neither is by itself.
    assert chosen(1.9, 0.5) is None


def test_a_name_that_is_less_probable_than_rivals_needs_the_claim_by_itself(stacked):
    rows, stack = stacked
    effect = candidate(stack, "gyro_g_sensitivity", ("gxx",))
    wave = wave_in_a_window(stack, "gyro.x")

    def chosen(physics, rival):
        return choose(rows, ranked(stacked, {effect: physics, wave: rival}), [])

    assert chosen(1.5, 2.0) is effect
    assert chosen(0.6, 0.5) is effect
    assert chosen(0.6, 1.1) is wave


def test_a_second_cause_outbids_a_rival_unless_it_is_there_beside_the_rival(stacked, monkeypatch):
    rows, stack = stacked
    effect = candidate(stack, "accel_settling", ("ky",))
    rival = next(c for c in stack if c.group == "speed of rotation accel.y")
    second = candidate(stack, "gyro_g_sensitivity", ("gxx",))

    def chosen(beside_rival):
        def again(rows, stack, accepted, start):
            alone = accepted[-1].candidate is effect
            return ranked(stacked, {second: 28.0 if alone else beside_rival})

        monkeypatch.setattr(search, "rank", again)
        return choose(rows, ranked(stacked, {rival: 48.0, effect: 30.0, second: 28.0}), [])

    assert chosen(2.0) is effect
    assert chosen(28.0) is rival


def test_causes_on_other_channels_lend_no_weight(stacked):
    rows, stack = stacked
    gyro = candidate(stack, "gyro_g_sensitivity", ("gxx",))
    accel = candidate(stack, "accel_cubic", ("kx",))
    wave = wave_in_a_window(stack, "gyro.x")

    def chosen(evidence):
        ranking = ranked(stacked, evidence)
        assert ranking.claims
        return choose(rows, ranking, [])

    assert chosen({gyro: 0.6, accel: 0.5}) is None
    assert chosen({gyro: 0.6, wave: 0.5}) is gyro
    assert chosen({gyro: 1.0, accel: 0.5}) is gyro


def test_low_passes_of_unlike_channels_stay_apart(stacked):
    rows, stack = stacked
    first = _accept(stack, candidate(stack, "bandwidth", ("accel",)), 100.0)
    new = _accept(stack, candidate(stack, "bandwidth", ("gyro",)), 50.0)
    apart = _with(rows, [first], new, reference=False)
    assert [a.candidate.parameters for a in apart] == [("accel",), ("gyro",)]


def test_what_an_exponential_leaves_is_not_named_after_it_again():
    real = recording(
        Term("gyro_warm_up", {"kx": 0.02, "ky": -0.02, "tau": 15.0}),
        Term("gyro_warm_up", {"kx": 0.04, "ky": 0.03, "tau": 150.0}),
        poses=24,
    )
    # Without a thermometer nothing but time is left to follow.
    found = diagnose_recording(replace(real, temperature=None), gravity=GRAVITY)
    assert [f.effect for f in found.findings].count("gyro_warm_up") == 1
    assert {u.follows for u in found.unexplained} & {"time", FROM_START}
    warm = next(f for f in found.findings if f.effect == "gyro_warm_up")
    assert "gyro_bias_temperature" in {r.effect for r in warm.rivals}
    assert "Cool the sensor" in warm.to_separate


def test_a_p_value_is_no_less_rare_than_evidence_of_noise():
    # Of 9000 draws of noise 48 reach the claim (`benchmarks/evidence.py`, seeds 9 to 11).
    assert 48 / 9000 < chance(CLAIM) < 0.01
    assert chance(1e-3) == 1.0


def test_what_a_drift_can_mimic_is_worth_less(stacked):
    rows, stack = stacked
    plain = rank(rows, stack, [], expected_levels(rows))
    groups = {"this": 2.0}
    alone = replace(plain, groups=groups, drifting=frozenset())
    mimicked = replace(plain, groups=groups, drifting=frozenset({"this"}))
    assert alone.worth == pytest.approx(2.0)
    assert mimicked.worth == pytest.approx(2.0 + np.log(DRIFTING))
    assert alone.claims
    assert not mimicked.claims
    assert not replace(plain, groups={}).claims


def test_nothing_is_chosen_below_the_claim(stacked):
    rows, stack = stacked
    ranking = rank(rows, stack, [], expected_levels(rows))
    assert choose(rows, ranking, []) is None


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
    mean = np.hstack((fitted(rows, []), stack.of(chosen)))[: rows.n_dense]
    basis = range_basis(mean)
    beside = level_likelihood(rows, basis, ranking.levels_with(chosen))
    assert beside > estimate_levels(rows, mean, ranking.levels).log_likelihood - 2 * NEAR
    assert beside > level_likelihood(rows, basis, ranking.levels) + 10.0
    # What is far behind is not looked at so closely.
    assert ranking.groups[top] > PLAIN
    behind = [c for g, c in ranking.best.items() if ranking.groups[g] < 0]
    assert behind
    for other in behind:
        assert ranking.levels_with(other) is ranking.levels


def test_a_twin_of_a_strong_effect_is_a_rival_though_its_column_is_a_derivative(monkeypatch):
    # While the temperature goes as an exponential, it and its rate differ by a constant only.
    sizes = {"kx": 10.0, "ky": -10.0, "kz": 20.0}
    real = recording(Term("accel_temperature_rate", sizes), poses=24)

    def named():
        (found,) = diagnose_recording(real, gravity=GRAVITY).findings
        return {found.effect, *(r.effect for r in found.rivals)}

    assert "accel_temperature_rate" in named()
    monkeypatch.setattr("calib.mismatch.search.twins.BLURRED", 0.0)
    assert "accel_temperature_rate" not in named()


@pytest.mark.parametrize(("size", "rival"), [(5.0, True), (-5.0, False)])
def test_what_would_be_of_an_impossible_size_is_no_rival(size, rival):
    """It lies beside a finding, however much more it explains."""
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=True)
    earth = candidate(stack, "earth_rate", ("east", "north", "up"))
    smoothing = candidate(stack, "reference_smoothing", ("position",))
    residual = rows.residual + stack.of(earth).sum(axis=1) + size * stack.of(smoothing)[:, 0]
    rows = replace(rows, residual=residual)
    found = _accept(stack, earth, 100.0)
    odds = _posterior(rows, stack, [found], 0, expected_levels(rows), reference=True)
    assert (odds.get("reference_smoothing", 0.0) > 0.5) is rival


@pytest.mark.parametrize(
    ("slug", "size", "beyond"),
    [
        ("accel_warm_up", 0.2 * GRAVITY, False),
        ("accel_warm_up", -2.0 * GRAVITY, True),
        ("gyro_warm_up", np.radians(10.0), False),
        ("gyro_warm_up", np.radians(100.0), True),
    ],
)
def test_no_sensor_warms_up_by_more_than_temperature_does(slug, size, beyond):
    """A sensor that is let go as the recording begins looks so, after seconds, and is none."""
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    warm = candidate(stack, slug, ("kx",))
    levels, mean = expected_levels(rows), fitted(rows, [])
    whitener = make_whitener(rows, levels, rows.white_diagonal, mean)
    typical = get_effect(slug).parameters[0].typical
    y = whitener.project(size / typical * stack.of(warm)[:, 0])
    assert (_possible(stack, warm, whitener, y) == -np.inf) is beyond


def test_what_is_a_little_larger_than_any_is_as_much_less_likely():
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    warm = candidate(stack, "accel_warm_up", ("kx",))
    levels, mean = expected_levels(rows), fitted(rows, [])
    whitener = make_whitener(rows, levels, rows.white_diagonal, mean)
    about = get_effect("accel_warm_up").parameters[0]
    column = whitener.project(stack.of(warm)[:, 0])
    sigma = about.typical / np.linalg.norm(column)

    def likely(beyond: float) -> float:
        size = (about.most + beyond * sigma) / about.typical
        return _possible(stack, warm, whitener, size * column)

    assert likely(-0.1) == 0.0
    assert likely(2.0) == pytest.approx(np.log(norm.cdf(-2.0) / 0.5))
    assert likely(3.1) == -np.inf


def test_levels_beside_an_effect_are_sought_from_closures_without_it():
    _, self_mode = problem()
    rows = self_mode.rows()
    base = expected_levels(rows)
    start = _swap(rows, base, 0.1 * base, ("gyro.x",))
    for component, ratio in zip(rows.components, start / base, strict=True):
        own = component.name.split(" ")[0] not in set(CHANNELS) - {"gyro.x"}
        assert ratio == pytest.approx(0.1 if own else 1.0), component.name
