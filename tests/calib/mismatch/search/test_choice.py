"""The explanation that is taken, of those that explain what is left."""

import numpy as np
import pytest
from scipy.stats import norm

from calib.effects import get_effect
from calib.mismatch.noise.noise import (
    expected_levels,
    make_whitener,
)
from calib.mismatch.search import choice
from calib.mismatch.search.accepted import contrast_noise, fitted
from calib.mismatch.search.choice import choose, possible
from calib.mismatch.search.ranking import Ranking, make_stack, rank

from ..bench import GRAVITY, problem
from .stacked import candidate


def ranked(stacked, evidence):
    rows, stack = stacked
    best = {c.group: c for c in evidence}
    groups = {c.group: value for c, value in evidence.items()}
    levels, mean = expected_levels(rows), fitted(rows, [])
    whitener = make_whitener(rows, levels, contrast_noise(rows, []), mean)
    return Ranking(stack, np.zeros(0), best, groups, levels, whitener)


def taken(rows, ranking):
    choice = choose(rows, ranking, [])
    return None if choice is None else choice.candidate


def wave_in_a_window(stack, channel):
    return next(c for c in stack if c.group == f"wave in a window {channel}")


def test_a_name_that_is_less_probable_than_rivals_needs_the_claim_by_itself(stacked):
    rows, stack = stacked
    effect = candidate(stack, "gyro_g_sensitivity", ("gxx",))
    wave = wave_in_a_window(stack, "gyro.x")

    def chosen(physics, rival):
        return taken(rows, ranked(stacked, {effect: physics, wave: rival}))

    assert chosen(1.5, 2.0) is effect
    assert chosen(0.6, 0.5) is effect
    assert chosen(0.6, 1.1) is wave


def test_a_second_cause_outbids_a_rival_unless_it_is_there_beside_the_rival(stacked, monkeypatch):
    rows, stack = stacked
    effect = candidate(stack, "accel_settling", ("ky",))
    rival = next(c for c in stack if c.group == "speed of rotation accel.y")
    second = candidate(stack, "gyro_g_sensitivity", ("gxx",))

    def chosen(beside_rival):
        def again(rows, stack, accepted, start, **_):
            alone = accepted[-1].candidate is effect
            return ranked(stacked, {second: 28.0 if alone else beside_rival})

        monkeypatch.setattr(choice, "rank", again)
        return taken(rows, ranked(stacked, {rival: 48.0, effect: 30.0, second: 28.0}))

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
        return taken(rows, ranking)

    assert chosen({gyro: 0.6, accel: 0.5}) is None
    assert chosen({gyro: 0.6, wave: 0.5}) is gyro
    assert chosen({gyro: 1.2, accel: 0.5}) is gyro


def test_what_is_passed_over_does_not_make_the_claim_stronger(stacked):
    rows, stack = stacked
    second = candidate(stack, "accel_cubic", ("kx",))
    wave = wave_in_a_window(stack, "accel.x")
    wild = candidate(stack, "gyro_g_sensitivity", ("gxx",))
    found = ranked(stacked, {wild: 60.0, wave: 4.0, second: 2.0})

    def impossible(stack, candidate, whitener, y):
        return -np.inf if candidate is wild else 0.0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choice, "possible", impossible)
        chosen = choose(rows, found, [])
    assert chosen.candidate is wave
    assert chosen.worth == pytest.approx(np.logaddexp(4.0, 2.0))


def test_nothing_is_chosen_below_the_claim(stacked):
    rows, stack = stacked
    ranking = rank(rows, stack, [], expected_levels(rows))
    assert choose(rows, ranking, []) is None


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
    assert (possible(stack, warm, whitener, y) == -np.inf) is beyond


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
        return possible(stack, warm, whitener, size * column)

    assert likely(-0.1) == 0.0
    assert likely(2.0) == pytest.approx(np.log(norm.cdf(-2.0) / 0.5))
    assert likely(3.1) == -np.inf
