"""What is found from signals alone: how much a sensor is shaken, and when it turns."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from calib.effects.base import State, Term
from calib.effects.observed import observed, observed_turns, since_and_during
from calib.effects.vibration import BESIDE, vibration_variance
from calib.model import SensorModel
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

RATES = [50.0, 100.0, 200.0, 1000.0]


def still(rate: float, seconds: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, seconds, 1 / rate)
    return time, np.zeros(len(time), bool)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("tone", [5.0, 12.0, 25.3, 40.0, 430.0])
def test_a_tone_has_its_variance_at_every_rate_aliased_or_not(rate: float, tone: float) -> None:
    time, turning = still(rate)
    wave = 3.0 * np.sin(2 * np.pi * tone * time + 0.4)
    if abs(tone / rate - round(2 * tone / rate) / 2) < 1e-3:
        pytest.skip("samples stand still on the wave")
    force = wave[:, None] * [1.0, 0.5, 0.0] + [0.0, 0.0, 9.8]
    found = vibration_variance(time, force, turning)
    inside = (time > 1.5) & (time < 18.5)
    np.testing.assert_allclose(found[inside, 0].mean(), 4.5, rtol=0.03)
    np.testing.assert_allclose(found[inside, 1].mean(), 4.5 / 4, rtol=0.03)
    np.testing.assert_allclose(found[:, 2], 0.0, atol=1e-12)


@pytest.mark.parametrize("rate", RATES)
def test_broad_vibration_has_its_variance(rate: float) -> None:
    time, turning = still(rate, 60.0)
    force = np.random.default_rng(1).normal(0, 2.0, (len(time), 3))
    found = vibration_variance(time, force, turning)
    # What is slow goes with motion: 1 of 25 Hz at the lowest of the rates, which is made up for.
    error = np.sqrt(2.0 / len(time))
    np.testing.assert_allclose(found.mean(axis=0), 4.0, rtol=4 * error + 0.003)


@pytest.mark.parametrize(("frequency", "most"), [(0.1, 4e-4), (0.3, 0.03), (0.5, 0.17)])
def test_what_is_slow_is_no_vibration(frequency: float, most: float) -> None:
    time, turning = still(100.0)
    wave = np.sin(2 * np.pi * frequency * time)[:, None] * np.ones(3)
    inside = slice(150, -150)
    assert vibration_variance(time, wave, turning)[inside].mean() < most * 0.5
    ramp = time[:, None] * np.ones(3)
    assert vibration_variance(time, ramp, turning)[inside].max() < 1e-12


def shaken_bench(*, rate: float, tone: float, seed: int = 4) -> tuple[State, np.ndarray]:
    """Return a hand's turns on a bench that shakes in its second half, and where that is."""
    motion = bench_protocol(np.random.default_rng(seed), poses=12)
    state = motion.state(np.arange(0.0, motion.duration, 1 / rate))
    shakes = state.time > 0.5 * motion.duration
    wave = np.sqrt(2.0) * np.sin(2 * np.pi * tone * state.time)
    force = state.force + (shakes * wave)[:, None] * np.ones(3)
    return State(state.time, force, state.rate), shakes


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
@pytest.mark.parametrize("tone", [5.0, 25.3, 40.0])
def test_vibration_goes_on_in_turns_and_a_hand_s_motion_is_none(rate: float, tone: float) -> None:
    state, shakes = shaken_bench(rate=rate, tone=tone)
    starts, ends, _ = observed_turns(state.time, state.rate)
    turning = since_and_during(state.time, starts, ends)[1]
    found = vibration_variance(state.time, state.force, turning)
    change = state.time[np.flatnonzero(np.diff(shakes))]
    clear = np.abs(state.time - change) > 4.0
    inside = (state.time > 1.0) & (state.time < state.time[-1] - 1.0)
    for where in (turning, ~turning):
        own = where & clear & inside
        np.testing.assert_allclose(found[own & shakes].mean(axis=0), 1.0, atol=0.06)
        assert found[own & ~shakes].mean() < 2e-3


def test_motion_without_rests_has_what_is_faster_than_a_hand() -> None:
    time, turning = still(200.0)
    wave = 3.0 * np.sin(2 * np.pi * 0.5 * time) + np.sin(2 * np.pi * 43.0 * time)
    found = vibration_variance(time, wave[:, None] * np.ones(3), ~turning)
    np.testing.assert_allclose(found.mean(), 0.5, rtol=0.05)
    # Far from a rest it says nothing of what shakes.
    some = np.abs(time - 10.0) > 0.5
    found = vibration_variance(time, wave[:, None] * np.ones(3), some)
    far = np.abs(time - 10.0) > 0.5 + BESIDE
    np.testing.assert_allclose(found[far].mean(), 0.5, rtol=0.05)


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
def test_turns_end_when_the_hand_stops(rate: float) -> None:
    motion = bench_protocol(np.random.default_rng(3), poses=15)
    bias = np.array([0.02, -0.02, 0.01])
    seen = simulate(motion, SensorModel(), CONSUMER, rng=np.random.default_rng(1), rate=rate)
    starts, ends, _ = observed_turns(seen.time, seen.gyro + bias)
    assert len(ends) == len(motion.turns)
    # The last 3 % of a turn are below the noise: at most 0.07 s.
    for found, true, sign in ((starts, motion.turns[:, 0], 1), (ends, motion.turns[:, 1], -1)):
        late = sign * (found - true)
        assert late.min() > -2 / rate
        assert late.max() < 0.09
        assert np.median(late) < 0.05


def test_what_rings_after_a_turn_without_noise_is_none() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    rate = np.zeros((len(time), 3))
    during = (time > 3.0) & (time < 4.0)
    rate[during, 2] = 1.5 * np.sin(np.pi * (time[during] - 3.0)) ** 2
    seen = sosfiltfilt(butter(4, 8.0, fs=100.0, output="sos"), rate, axis=0)
    starts, ends, _ = observed_turns(time, seen)
    assert starts == pytest.approx([3.0], abs=0.05)
    assert ends == pytest.approx([4.0], abs=0.05)


def test_what_is_carried_when_it_turns_no_more_has_not_ended_its_move() -> None:
    """Settling began where the turn ended: its time constant was twice what it is."""
    time = np.arange(0.0, 10.0, 0.01)
    rate, force = np.random.default_rng(4).normal(0.0, [[[0.002]], [[0.03]]], (2, len(time), 3))
    force[:, 2] += 9.81
    rate[300:400, 1] += 2.0
    force[290:445, 0] += np.hanning(155) + 0.3
    starts, ends, _ = observed_turns(time, rate, force)
    assert starts == pytest.approx([2.9], abs=0.011)
    assert ends == pytest.approx([4.44], abs=0.011)


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0, 1000.0])
@pytest.mark.parametrize("tone", [12.0, 20.0, 35.0])
def test_what_rings_when_it_is_put_down_has_ended_its_move(rate: float, tone: float) -> None:
    """Settling was counted from where the ringing was over, later after each louder knock.

    But what rings is no vibration of the rest.
    """
    time = np.arange(0.0, 10.0, 1 / rate)
    force = np.random.default_rng(4).normal(0.0, 0.03, (len(time), 3))
    force[:, 2] += 9.81
    turns = np.zeros((len(time), 3))
    turns[(time >= 3.0) & (time < 4.0), 1] = 2.0
    after = np.maximum(time - 4.0, 0.0)
    knock = (time >= 4.0) * 5.0 * np.exp(-after / 0.05) * np.cos(2 * np.pi * tone * after)
    found = observed_turns(time, turns, force + knock[:, None] * [0.4, 0.4, 1.0])
    assert found.end == pytest.approx([4.0], abs=0.03)
    assert 4.1 < found.quiet[0] < 4.4
    state = observed(
        State(time, force + knock[:, None] * np.ones(3), turns), ("vibration", "since_turn")
    )
    assert state.vibration is not None
    assert state.vibration[time > 3.0].max() < 0.02


def test_a_pause_on_the_way_ends_no_turn_and_what_shakes_is_none() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    rate = np.zeros((len(time), 3))
    rate[200:300, 1] = 1.0
    rate[240:250, 1] = 0.0  # on the way
    rate[600:700, 2] = -1.0
    starts, ends, _ = observed_turns(time, rate)
    np.testing.assert_allclose(starts, [2.0, 6.0])
    np.testing.assert_allclose(ends, [2.99, 6.99])
    since, turning = since_and_during(time, starts, ends)
    assert np.isinf(since[:299]).all()
    np.testing.assert_allclose(since[[299, 399, 650, 799]], [0.0, 1.0, 3.51, 1.0], atol=1e-9)
    expected = np.zeros(len(time), bool)
    expected[200:299], expected[600:699] = True, True
    np.testing.assert_array_equal(turning, expected)
    shaking = 0.5 * np.sin(2 * np.pi * 24.0 * time)[:, None] * np.ones(3)
    for none in (0 * rate, shaking):
        assert [len(edges) for edges in observed_turns(time, none)] == [0, 0, 0]


@pytest.mark.parametrize("tau", [0.3, 0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_settling_is_gone_when_it_is_corrected(tau: float, rate: float) -> None:
    """Its time counts from the end that is observed, so its size is that of there."""
    motion = bench_protocol(np.random.default_rng(8), poses=12)
    term = Term("accel_settling", {"kx": 0.03, "tau": tau})
    without, seen = (
        simulate(motion, SensorModel(terms=t), CONSUMER, rng=np.random.default_rng(0), rate=rate)
        for t in ((), (term,))
    )
    _, ends, _ = observed_turns(seen.time, seen.gyro, seen.accel)
    late = np.exp((motion.turns[:, 1] - ends) / tau)
    fitted = Term("accel_settling", {"kx": 0.03 * float(late.mean()), "tau": tau})
    found = SensorModel(terms=(fitted,)).correct(State(seen.time, seen.accel, seen.gyro))
    state = motion.state(seen.time)
    rest = ~state.turning & (state.since_turn < 3 * tau)
    left = found.accel[rest, 0] - without.accel[rest, 0]
    there = seen.accel[rest, 0] - without.accel[rest, 0]
    # All ends are found alike but for a hundredth of a second.
    assert np.sqrt(np.mean(left**2)) < 0.012 / tau * np.sqrt(np.mean(there**2))


def test_a_correction_counts_from_when_a_hand_lets_go_as_the_diagnosis_does() -> None:
    """It carries the sensor for a while after it has stopped to turn it."""
    time = np.arange(0.0, 12.0, 0.01)
    inside, carried = (time > 4.0) & (time < 5.0), (time > 5.0) & (time < 5.4)
    rate = np.outer(inside * 2.0 * np.sin(np.pi * (time - 4.0)), [0.0, 0.0, 1.0])
    force = np.outer(np.ones(len(time)), [0.0, 0.0, 9.8])
    force[:, 0] += carried * 2.0 * np.sin(2 * np.pi * (time - 5.0) / 0.4)
    seen = observed(State(time, force, rate), ("since_turn",))
    assert seen.since_turn is not None
    assert seen.since_turn[time > 6.0][0] == pytest.approx(6.01 - 5.4, abs=0.03)
