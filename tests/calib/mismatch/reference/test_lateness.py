"""How late a triad is: roughly found, and put into columns."""

import numpy as np
import pytest

from calib.effects.base import State
from calib.mismatch.reference.lateness import ENOUGH, LATE, REACH, delaying, liveliest, rough_delay
from calib.model import SensorModel
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import NoiseModel


def turning(time, rng):
    """Turns of two seconds with a tremor of 9 Hz on them, three channels."""
    slow = np.sin(np.pi * time[:, None] / np.array([2.0, 2.6, 3.1])) ** 3
    return slow + 0.05 * np.sin(2 * np.pi * 9.0 * time[:, None] + rng.uniform(0, 6, 3))


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
@pytest.mark.parametrize("late", [0.0, 0.04, 0.0123, -0.03, -0.11])
def test_a_triad_is_placed_to_a_part_of_a_sample(rate, late):
    time = np.arange(0.0, 60.0, 1.0 / rate)
    true, measured = (turning(time - d, np.random.default_rng(3)) for d in (0.0, late))
    noise = np.random.default_rng(4).normal(0.0, 0.02, measured.shape)
    found = rough_delay(1.02 * measured + 0.3 + noise, (true,), 1.0 / rate)
    assert found == pytest.approx(late, abs=0.001)


@pytest.mark.parametrize("late", [0.0, 0.03])
def test_what_a_long_arm_feels_is_no_delay(late):
    worst = 0.0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motion = bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(1.0, 3.0))
        recording = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=100.0)
        state = State(recording.time, recording.accel, recording.gyro)
        felt = (state.force, *np.moveaxis(state.gradient, -1, 0))
        arm = 0.6 * rng.normal(size=3) / np.sqrt(3.0)
        measured = delaying(state.time, late) @ (state.force + state.gradient @ arm)
        assert rough_delay(measured, felt, 0.01) == pytest.approx(late, abs=1e-3)
        alone = rough_delay(measured, felt[:1], 0.01)
        worst = np.inf if alone is None else max(worst, abs(alone - late))
    # Were the arm not known of, it would have been one, or have told nothing.
    assert worst > LATE


def test_beyond_the_search_nothing_is_said():
    time = np.arange(0.0, 60.0, 0.01)

    def step(late):
        return np.clip((time - 30.0 - late) / 0.5, 0.0, 1.0)[:, None] * np.ones(3)

    assert rough_delay(step(0.8 * REACH), (step(0.0),), 0.01) == pytest.approx(0.8 * REACH)
    assert rough_delay(step(1.5 * REACH), (step(0.0),), 0.01) is None


def test_what_feels_nothing_of_the_motion_tells_of_no_lag():
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 60.0, 0.01)
    true = 1e-6 * turning(time, rng)
    assert rough_delay(rng.normal(0.0, 0.02, true.shape), (true,), 0.01) is None


def test_of_a_long_recording_the_liveliest_part_tells():
    rate = np.zeros((3 * ENOUGH + 500, 3))
    rate[ENOUGH + 100 : ENOUGH + 200, 1] = 1.0
    assert liveliest(rate) == slice(ENOUGH, 2 * ENOUGH)
    assert liveliest(rate[:50]).start == 0


@pytest.mark.parametrize("delay", [0.04, -0.03, 0.0137, 0.0])
def test_a_delayed_signal_is_that_of_the_time_before(delay):
    # At 50 Hz, a tremor of 6 Hz has eight samples.
    time = np.arange(0.0, 10.0, 0.02)
    inner = slice(10, -10)
    omega = 2 * np.pi * 6.0
    found = delaying(time, delay) @ np.sin(omega * time)
    # A cubic's error is at most (w h)^4 3 / 128.
    bound = (omega * 0.02) ** 4 * 3 / 128 + 1e-12
    np.testing.assert_allclose(found[inner], np.sin(omega * (time - delay))[inner], atol=bound)
    assert delaying(time, delay).sum(axis=1) == pytest.approx(1.0)


def test_ends_are_held():
    time = np.arange(0.0, 1.0, 0.01)
    found = delaying(time, 0.05) @ (1.0 + time)
    np.testing.assert_allclose(found[:5], 1.0, atol=1e-12)
