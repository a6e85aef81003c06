"""Motions that samples do not follow: corners, here and there or everywhere."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from calib.mismatch import diagnose_against
from calib.mismatch.reference.corners import SELDOM, is_common, shared_jumps, unfollowed
from calib.mismatch.reference.filters import smoothed
from calib.mismatch.reference.truths import DEGREE
from calib.recording import Recording

GRAVITY = 9.80665
REST, TURN, RAMP, TOP, TURNS = 3.0, 1.0, 0.15, 4.0, 24
NOISE = np.array([0.02, 1e-3])


def cornered(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return force and rate (n, 3) of turns whose rate goes up and down at a constant pace."""
    turn = np.clip((time / (REST + TURN)).astype(int), 0, TURNS - 1)
    since = time - turn * (REST + TURN) - REST
    knots, rates = np.array([0.0, RAMP, TURN - RAMP, TURN]), np.array([0.0, TOP, TOP, 0.0])
    rate = np.interp(since, knots, rates)
    up = np.clip(since, 0.0, RAMP)
    down = np.clip(since - (TURN - RAMP), 0.0, RAMP)
    angle = TOP * np.clip(since - RAMP, 0.0, TURN - 2 * RAMP)
    angle += TOP * (up**2 + RAMP**2 - (RAMP - down) ** 2) / (2 * RAMP)
    axes = np.eye(3)[np.arange(TURNS) % 3] * np.where(np.arange(TURNS) % 4 < 2, 1.0, -0.6)[:, None]
    starts = [Rotation.identity()]
    for axis in axes:
        starts.append(starts[-1] * Rotation.from_rotvec(TOP * (TURN - RAMP) * axis))
    begun = Rotation.concatenate([starts[k] for k in turn])
    mat_ns = begun * Rotation.from_rotvec(angle[:, None] * axes[turn])
    return mat_ns.inv().apply([0.0, 0.0, GRAVITY]), rate[:, None] * axes[turn]


def simulated(rate: float) -> Recording:
    time = np.arange(0.0, TURNS * (REST + TURN), 1 / rate)
    return Recording(time - 5.0, *cornered(time), "device")


def recorded(rate: float, noise: np.ndarray, *, gain: float = 1.0) -> Recording:
    rng = np.random.default_rng(3)
    time = np.arange(0.0023, TURNS * (REST + TURN), 1 / rate)
    force, turning = cornered(time)
    turning = turning + (gain - 1.0) * np.abs(turning) * [1.0, 0.0, 0.0]
    accel = force + 0.1 + noise[0] * rng.normal(size=force.shape)
    gyro = turning + 0.01 + noise[1] * rng.normal(size=force.shape)
    return Recording(time, accel, gyro, "device")


def test_the_motion_of_these_tests_is_one():
    """The rate is that of the force: gravity turns with it."""
    time = np.arange(0.0, 96.0, 1e-3)
    force, rate = cornered(time)
    change = np.gradient(force, 1e-3, axis=0)
    assert np.abs(change + np.cross(rate, force))[2:-2].max() < 0.2


@pytest.mark.parametrize(
    ("rates", "noise"),
    [
        ((50.0, 200.0), NOISE),
        ((100.0, 50.0), 0.1 * NOISE),
    ],
)
@pytest.mark.long
def test_corners_that_a_simulation_rounds_off_are_no_error_of_the_sensor(rates, noise):
    """They looked like a low-pass and a delay, at p < 1e-6."""
    real = recorded(rates[0], noise)
    found = diagnose_against(real, simulated(rates[1]), gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert found.missing or found.summary["corners"] > 0


@pytest.mark.long
def test_an_effect_is_found_between_corners():
    real = recorded(100.0, NOISE, gain=1.002)
    found = diagnose_against(real, simulated(200.0), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_scale_asymmetry"]
    value = found.findings[0].parameters["kx"]
    assert abs(value.value - 0.002) < 3 * value.sigma
    assert not found.unexplained


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0])
def test_what_a_spline_errs_by_is_noise_outside_of_what_is_left_out(rate):
    few = simulated(rate)
    out = unfollowed(few, NOISE)
    assert 0 < out.mean() < 0.3
    assert is_common(out, few.gyro) is (rate < 100.0)
    time = np.arange(1.0, 90.0, 0.0007)
    error = np.abs(make_interp_spline(few.time, few.gyro, k=DEGREE)(time - 5.0) - cornered(time)[1])
    beside = np.convolve(out, np.ones(5), mode="same")[np.searchsorted(few.time, time - 5.0)] > 0
    assert error[~beside].max() < NOISE[1] < 3 * NOISE[1] < error[beside].max()


def test_a_tremor_is_followed_if_it_has_four_samples_and_not_if_it_has_less_than_three():
    time = np.arange(2000) / 100.0
    for frequency, followed in ((10.0, True), (20.0, True), (36.0, False)):
        wave = 0.5 * np.sin(2 * np.pi * frequency * time)[:, None] * np.ones(3)
        out = unfollowed(Recording(time, 0.1 * wave, wave, "device"), NOISE)
        assert is_common(out, wave) is not followed
        assert out[50:-50].all() or followed


def test_what_is_too_short_has_no_corners():
    time = np.arange(20) / 100.0
    still = np.zeros((20, 3))
    assert not unfollowed(Recording(time, still, still, "device"), NOISE).any()


def let_go(time: np.ndarray, *, force: float = 5.0) -> np.ndarray:
    """Return (n, 6) signals of what feels another force from one moment on, and then swings."""
    since = np.clip(time - 10.003, 0.0, None)
    out = np.zeros((len(time), 6))
    out[:, 0] = np.where(since > 0, force * np.cos(2.0 * since), 0.0)
    out[:, 2] = GRAVITY
    out[:, 3] = np.sin(2.0 * since)
    return out


def jumps_of(sensed: np.ndarray, seen: np.ndarray, time: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(2).normal(size=(len(time), 6)) * np.repeat(NOISE, 3)
    measured = sensed + noise
    recording = Recording(time, measured[:, :3], measured[:, 3:], "device")
    band = 5.0
    kept, other = (smoothed(time, values, band) for values in (measured, seen))
    return shared_jumps(recording, NOISE, kept, other, round(0.5 / band / (time[1] - time[0])))


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_what_is_let_go_jumps_for_both_at_that_moment_alone(rate):
    time = np.arange(0.0, 60.0, 1 / rate)
    found = jumps_of(let_go(time), let_go(time), time)
    assert found[np.searchsorted(time, 10.003)]
    assert np.abs(time[found] - 10.003).max() < 0.1 + 24 / rate
    # As it swings it does not, nor where it is let go gently.
    assert not jumps_of(*2 * (let_go(time, force=0.2),), time).any()


def test_what_a_sensor_does_alone_is_no_jump_of_the_motion():
    time = np.arange(0.0, 60.0, 0.01)
    still = np.tile([0.0, 0.0, GRAVITY, 0.0, 0.0, 0.0], (len(time), 1))
    stepped, spiked, loud = still.copy(), still.copy(), still.copy()
    stepped[3000:, 0] += 3.0
    spiked[3000, 1] += 30.0
    loud[3000:3300, :3] += np.random.default_rng(1).normal(0, 3.0, (300, 3))
    for sensed in (stepped, spiked, loud):
        assert not jumps_of(sensed, still, time).any()
    # Of what jerks all the while they are no exception.
    jerked = still + [5.0, 0.0, 0.0, 0.0, 0.0, 0.0] * (time[:, None] // 2.0 % 2.0)
    assert jumps_of(jerked, jerked, time).mean() > SELDOM
    assert jumps_of(*2 * (np.where(time[:, None] < 5.0, jerked, jerked[-1]),), time).any()
    shaken = still + np.random.default_rng(1).normal(0, 3.0, still.shape)
    assert not jumps_of(shaken, shaken, time).any()


def test_what_moves_on_in_a_gap_of_the_sensor_s_own_is_no_jump():
    time = np.arange(0.0, 60.0, 0.01)
    swung = GRAVITY * np.stack([np.sin(0.8 * time), np.zeros_like(time), np.cos(0.8 * time)])
    whole = np.hstack((swung.T, np.zeros((len(time), 3))))
    known = (time < 20.0) | (time > 23.0)
    assert not jumps_of(whole[known], whole[known], time[known]).any()
