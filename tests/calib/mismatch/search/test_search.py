"""The search: one finding for one cause, however often the evidence comes back to it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.rivals import FROM_START
from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.search.accepted import accept, fitted
from calib.mismatch.search.choice import Choice
from calib.mismatch.search.ranking import make_stack, rank
from calib.mismatch.search.refit import refit
from calib.mismatch.search.search import (
    BEATEN,
    _bent,
    _exchanged,
    _judged,
    _posterior,
    _State,
)
from calib.mismatch.twin.selfmode import SelfProblem
from calib.statics import find_poses

from ..bench import GRAVITY, problem, recording, with_added
from .stacked import candidate


@pytest.mark.long
def test_what_an_exponential_leaves_is_not_named_after_it_again():
    real = recording(
        Term("gyro_warm_up", {"kx": 0.02, "ky": -0.02, "tau": 15.0}),
        Term("gyro_warm_up", {"kx": 0.04, "ky": 0.03, "tau": 150.0}),
        poses=18,
    )
    # Without a thermometer nothing but time is left to follow.
    found = diagnose_recording(replace(real, temperature=None), gravity=GRAVITY)
    assert [f.effect for f in found.findings].count("gyro_warm_up") == 1
    assert {u.follows for u in found.unexplained} & {"time", FROM_START}
    warm = next(f for f in found.findings if f.effect == "gyro_warm_up")
    assert "gyro_bias_temperature" in {r.effect for r in warm.rivals}
    assert "Cool the sensor" in warm.to_separate


@pytest.mark.long
def test_a_twin_of_a_strong_effect_is_a_rival_though_its_column_is_a_derivative(monkeypatch):
    # While the temperature goes as an exponential, it and its rate differ by a constant only.
    sizes = {"kx": 10.0, "ky": -10.0, "kz": 20.0}
    real = recording(Term("accel_temperature_rate", sizes), poses=24)
    # The rate is as well known as the thermometer's steps let it be.
    real = replace(real, temperature=0.25 * np.round(4.0 * real.temperature))

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
    found = accept(stack, earth, 100.0)
    odds = _posterior(rows, stack, [found], 0, expected_levels(rows), reference=True)
    assert (odds.get("reference_smoothing", 0.0) > 0.5) is rival


@pytest.mark.parametrize("there", [True, False])
def test_another_kind_is_no_rival_of_what_was_placed_in_its_window(there):
    """It was 1000 times as probable in the window that fits it best, of many that are as good."""
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    every = [stack[i] for i in range(len(stack))]
    bias, *_ = (c for c in every if c.group == "bias in a window accel.y")
    assert bias.interval is not None
    middle = 0.5 * sum(bias.interval)
    gain = next(
        c
        for c in every
        if c.group == "gain in a window accel.y"
        and c.interval is not None
        and (c.interval[0] < middle < c.interval[1]) is there
        and (there or c.interval[0] > bias.interval[1])
    )
    size = 30.0 / np.sqrt(np.square(stack.of(bias)).max())
    residual = rows.residual + size * rows.white[1, 1] ** 0.5 * stack.of(bias).sum(axis=1)
    found = accept(stack, gain, 100.0)
    rows = replace(rows, residual=residual)
    odds = _posterior(rows, stack, [found], 0, expected_levels(rows), reference=False)
    assert odds[bias.group] > 0.4
    assert (odds.get(gain.group, 0.0) > 0.4) is there


@pytest.mark.long
def test_a_step_that_bends_the_rows_has_its_name():
    # 0.3 m/s² in a turn: what is in proportion to it leaves more than a fluctuation would.
    rests = find_poses(recording(seed=4, poses=30)).interval
    moment = 0.85 * rests[14, 1] + 0.15 * rests[15, 0]
    real = recording(
        Term("accel_bias_step", {"bx": 0.3, "by": -0.2, "moment": float(moment)}), seed=4, poses=30
    )
    found = diagnose_recording(real, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["accel_bias_step"]
    assert not found.unexplained
    about = found.findings[0].parameters
    assert abs(about["moment"].value - moment) < 4 * about["moment"].sigma


def g_sensitive(size):
    """Return a recording's twin, its rows, their ranking, and the effect in it."""
    real = recording(Term("gyro_g_sensitivity", {"gxx": size, "gyy": -size}))
    self_mode = SelfProblem(
        make_grid(real, find_poses(real)), None, gravity=GRAVITY, full_gyro=False
    )
    rows = self_mode.rows()
    ranking = rank(rows, make_stack(rows, skip=(), reference=False), [], expected_levels(rows))
    own = ranking.best["gyro_g_sensitivity"]
    return self_mode, rows, ranking, own


def test_a_model_goes_back_to_where_it_stood(monkeypatch):
    self_mode, rows, ranking, own = g_sensitive(3e-3)
    monkeypatch.setattr("calib.mismatch.search.search.rank", lambda *_, **__: ranking)
    led = Choice(own, 100.0, ((own, 10.0),))
    short = led._replace(behind=((own, 4.0),))
    assert _bent(self_mode, rows, ranking, [], short, skip=()) is None
    # Here as much is left as there was, and that is more than any lead.
    assert _bent(self_mode, rows, ranking, [], led, skip=()) is None
    np.testing.assert_array_equal(self_mode.rows().residual, rows.residual)
    led = led._replace(behind=((own, ranking.total + 10.0),))
    assert _bent(self_mode, rows, ranking, [], led, skip=()) is not None
    assert np.abs(self_mode.rows().residual).sum() < np.abs(rows.residual).sum()


def test_where_rows_are_straight_a_rival_that_leads_is_the_answer():
    self_mode, rows, ranking, own = g_sensitive(1e-4)
    led = Choice(own, 100.0, ((own, ranking.total + 100.0),))
    assert _bent(self_mode, rows, ranking, [], led, skip=()) is None
    np.testing.assert_array_equal(self_mode.rows().residual, rows.residual)


@pytest.mark.long
def test_a_finding_that_another_beats_is_exchanged_for_it():
    real = recording(Term("gyro_g_sensitivity", {"gxx": 4e-4, "gyz": -4e-4, "gzx": 4e-4}), poses=18)
    made = SelfProblem(make_grid(real, find_poses(real)), None, gravity=GRAVITY, full_gyro=False)
    rows = made.rows()
    stack, seen = make_stack(rows, skip=(), reference=False), fitted(rows, [])
    wrong = accept(stack, candidate(stack, "gyro_g_squared_sensitivity", ("gx", "gy", "gz")), 10.0)
    rows, accepted, levels, _ = refit(made, rows, [wrong], expected_levels(rows))
    ranking = rank(rows, stack, accepted, levels)
    ended = _judged(made, _State(rows, accepted, stack, seen, replace(ranking, levels=levels)))
    assert ended.against[0] > BEATEN
    other = _exchanged(made, ended, skip=())
    assert other is not None
    assert [a.candidate.group for a in other.state.accepted] == ["gyro_g_sensitivity"]
    assert max(other.against) < 1.0
    # Nothing beats that one, and all is as it was where nothing better is found.
    place = made.place()
    assert _exchanged(made, other._replace(against=[0.0]), skip=()) is None
    assert made.place() is place


@pytest.mark.long
def test_a_window_between_those_of_the_grid_is_not_beaten_by_what_is_on_it():
    real = recording(seed=8, poses=20)
    rests = find_poses(real).interval
    start, stop = rests[6, 0] + 1.0, rests[12, 1] - 1.0
    inside = (real.time >= start) & (real.time < stop)
    found = diagnose_recording(with_added(real, {"gyro.z": 6e-4 * inside}), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert left.channels == ("gyro.z",)
    assert left.intervals[0] == pytest.approx((start, stop), abs=4.0)
    assert left.size is not None
    assert (left.size.value, left.size.unit) == (pytest.approx(6e-4, rel=0.4), "rad/s")
    assert max((r.odds for r in left.rivals), default=0.0) < BEATEN
