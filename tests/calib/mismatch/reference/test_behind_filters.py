"""What a low-pass leaves of turns beside a simulation is no jump, no pulse and no jolt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from calib.mismatch import diagnose_against, diagnose_reference
from calib.mismatch.reference.slips import find_slips
from calib.model import SensorModel
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.types import FloatArray

GRAVITY, RATE, REST, TURN, TURNS = 9.80665, 100.0, 3.0, 1.2, 24
FINE = 2e-4
Share = Callable[[FloatArray], FloatArray]
MINIMUM_JERK: tuple[Share, Share] = (
    lambda u: u**3 * (10.0 - 15.0 * u + 6.0 * u**2),
    lambda u: 30.0 * np.square(u * (1.0 - u)),
)
CORNERED: tuple[Share, Share] = (lambda u: u**2 * (3.0 - 2.0 * u), lambda u: 6.0 * u * (1.0 - u))
"""Angle and rate of a turn, of its whole angle and its time: the second begins with a corner."""


def motion(time: FloatArray, course: tuple[Share, Share]) -> tuple[FloatArray, FloatArray]:
    """Return force and rate (n, 3)."""
    rng = np.random.default_rng(0)
    angle = np.radians(rng.uniform(60.0, 150.0, TURNS)) * rng.choice([-1.0, 1.0], TURNS)
    axis = rng.normal(size=(TURNS, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    turn = np.clip((time / (REST + TURN)).astype(int), 0, TURNS - 1)
    share = np.clip((time - turn * (REST + TURN) - REST) / TURN, 0.0, 1.0)
    poses = [Rotation.from_rotvec([0.3, 0.2, 0.0])]
    for one, by in zip(axis, angle, strict=True):
        poses.append(poses[-1] * Rotation.from_rotvec(by * one))
    turned = Rotation.from_rotvec((course[0](share) * angle[turn])[:, None] * axis[turn])
    mat_ns = Rotation.concatenate([poses[k] for k in turn]) * turned
    rate = (course[1](share) * angle[turn] / TURN)[:, None] * axis[turn]
    return mat_ns.inv().apply([0.0, 0.0, GRAVITY]), rate


def low_passed(rate: FloatArray, cutoff: float) -> FloatArray:
    """Return (n, 3) rates at fine steps through a first order low-pass, as late as a real one."""
    pole = np.exp(-2.0 * np.pi * cutoff * FINE)
    return np.asarray(lfilter([0.5 - 0.5 * pole] * 2, [1.0, -pole], rate, axis=0))


@pytest.mark.long
@pytest.mark.parametrize(
    ("course", "cutoff"), [(CORNERED, 13.0), (MINIMUM_JERK, 13.0), (MINIMUM_JERK, 40.0)]
)
def test_a_low_pass_is_all_that_is_said(course: tuple[Share, Share], cutoff: float) -> None:
    rng = np.random.default_rng(1)
    end = TURNS * (REST + TURN) + REST
    fine, time = np.arange(0.0, end, FINE), np.arange(0.0023, end - 1.0, 1.0 / RATE)
    late = low_passed(motion(fine, course)[1], cutoff)
    gyro = np.stack([np.interp(time, fine, own) for own in late.T], axis=1)
    accel = motion(time, course)[0]
    accel = 1.002 * accel + 0.1 + 0.02 * rng.normal(size=accel.shape)
    gyro = 1.003 * gyro + 0.01 + 1e-3 * rng.normal(size=gyro.shape)
    real = Recording(time, accel, gyro, "device")
    time = np.arange(0.0, end, 1.0 / RATE)
    truth = Recording(time - 5.0, *motion(time, course), "device")
    found = diagnose_against(real, truth, gravity=GRAVITY)
    (only,) = found.findings
    assert only.effect == "bandwidth"
    size = only.parameters["gyro_cutoff"]
    assert size.sigma is not None
    assert abs(size.value - cutoff) < 4.0 * size.sigma
    assert not found.unexplained


@pytest.mark.long
def test_a_low_pass_that_is_worked_out_at_the_samples_is_one_beside_another_imu() -> None:
    """It is earlier than its pole says, by up to half a sample: that is no delay besides.

    Jolts are left out of such a comparison, and what follows one is not filtered anew from there.
    """
    rng = np.random.default_rng(1)
    base = bench_protocol(rng, poses=16, pose_duration=(2.0, 3.0), vibration=0.0)
    other = simulate(base, SensorModel(), CONSUMER, rng=rng, rate=RATE)
    real = simulate(base, SensorModel(), NoiseModel(), rng=rng, rate=RATE)
    share = 1.0 - np.exp(-2.0 * np.pi * 15.0 / RATE)
    gyro = lfilter([share], [1.0, share - 1.0], real.gyro, axis=0)
    noise = rng.normal(size=(2, *gyro.shape)) * np.array([0.01, 1e-3])[:, None, None]
    real = replace(real, accel=real.accel + noise[0], gyro=gyro + noise[1])
    found = diagnose_reference(real, other, gravity=GRAVITY)
    (own,) = [f for f in found.findings if set(f.channels) <= set(CHANNELS[3:])]
    assert own.effect == "bandwidth"
    size = own.parameters["gyro_cutoff"]
    assert size.sigma is not None
    assert abs(size.value - 15.0) < 4.0 * size.sigma < 1.0
    assert not found.unexplained


def test_what_filters_may_be_wrong_by_is_no_slip() -> None:
    time = np.arange(0.0, 5.0, 1.0 / RATE)
    rng = np.random.default_rng(2)
    left = 1e-3 * rng.normal(size=(len(time), 3))
    about = (time >= 2.0) & (time < 2.2)
    left[about, 1] += 0.1
    rate = np.zeros_like(left)
    (found,) = find_slips(time, left, rate, about, 1.0 / RATE)
    assert found.channels == ("gyro.y",)
    assert not find_slips(time, left, rate, about, 1.0 / RATE, 0.11)
    assert find_slips(time, left, rate, about, 1.0 / RATE, 0.05)
