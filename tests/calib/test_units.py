"""Units of single axes, by the ellipsoid on which poses lie."""

from dataclasses import replace

import numpy as np
import pytest

from calib.audit import audit
from calib.gravity import STANDARD_GRAVITY
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.tilts import AGREE, DEGREE, Closure
from calib.types import FloatArray
from calib.units import unit_faults

# Swung by hand: rests near these, and one push that lasts as long as a rest.
POSES = np.array(
    [
        [0.48, 0.27, 9.79],
        [-3.84, -8.5, -3.02],
        [-0.09, -4.09, 8.91],
        [-3.85, 1.43, 8.91],
        [-3.5, -8.24, -4.01],
        [-8.29, -4.66, -2.39],
        [6.6, 7.18, -1.0],
        [6.97, 6.89, -0.47],
        [-0.77, -2.58, 9.43],
        [-3.77, -6.85, -12.89],
        [1.11, 1.93, 9.55],
        [6.68, 6.24, -3.55],
        [-6.71, -6.63, -2.68],
    ]
)


@pytest.fixture(scope="module")
def real() -> Recording:
    rng = np.random.default_rng(3)
    motion = bench_protocol(rng, poses=13, power_on=0.0)
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)


def channels_of(real: Recording, accel: FloatArray) -> list[int | None]:
    poses = find_poses(real)
    assert len(poses) == len(accel)
    return [f.channel for f in unit_faults(real, replace(poses, accel=accel), None)]


def test_a_push_among_the_rests_is_no_unit(real: Recording) -> None:
    assert channels_of(real, POSES) == []


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0])
def test_an_axis_in_another_unit_is_found_in_all_poses(
    real: Recording, axis: int, factor: float
) -> None:
    rng = np.random.default_rng(5)
    directions = rng.standard_normal((13, 3))
    accel = STANDARD_GRAVITY * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    accel[:, axis] *= factor
    assert channels_of(real, accel) == [axis]


@pytest.mark.parametrize("seed", range(12))
def test_an_axis_that_gravity_never_reached_has_no_unit(real: Recording, seed: int) -> None:
    # Turned about nearly one axis: the ellipsoid of the poses has any length along that.
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, 13)
    up = np.stack((0.02 * rng.standard_normal(13), np.cos(angle), np.sin(angle)), axis=1)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    bias = np.array([0.35, -0.22, 0.6])
    accel = STANDARD_GRAVITY * up * [1.01, 0.98, 1.02] + bias + 2e-3 * rng.standard_normal((13, 3))
    assert channels_of(real, accel) == []


def test_long_motion_between_two_rests_is_no_unit(real: Recording) -> None:
    """A gyroscope that forgets (a high-pass) is off anywhere by then, and some factor has it."""
    poses = find_poses(real)
    rng = np.random.default_rng(6)
    wrong = 0
    for last in range(5, len(poses)):
        own = poses.select(np.array([0, last]))
        bent = replace(real, gyro=real.gyro * rng.uniform(0.3, 0.8, 3))
        closure = Closure.of(bent, own)
        if closure is not None:
            wrong += not closure.missed < 0.5
            assert not unit_faults(bent, own, closure)
    assert wrong > 3


def test_one_straight_turn_tells_of_a_unit(real: Recording) -> None:
    poses = find_poses(real)
    told = 0
    for first in range(len(poses) - 1):
        own = poses.select(np.array([first, first + 1]))
        degrees = replace(real, gyro=np.degrees(real.gyro))
        if (closure := Closure.of(degrees, own)) is not None:
            found = [f.factor for f in unit_faults(degrees, own, closure)]
            told += found == [pytest.approx(1 / DEGREE)]
    assert told > 5


@pytest.mark.parametrize("seed", [5, 13, 21])
def test_a_quarter_of_g_of_bias_is_no_disagreement(seed: int) -> None:
    """An ADXL345 may have it: gravity leans by fifteen degrees at either end of a turn."""
    rng = np.random.default_rng(seed)
    sensor = SensorModel(accel=Triad(np.array([1.4, -1.4, 2.4])))
    motion = bench_protocol(rng, poses=13, power_on=0.0)
    own = simulate(motion, sensor, CONSUMER, rng=rng, rate=50.0)
    closure = Closure.of(own, find_poses(own))
    assert closure is not None
    assert closure.missed > AGREE
    assert closure.agrees
    assert not [f for f in audit(own).findings if f.kind == "axes"]
    wrong = Closure.of(replace(own, gyro=own.gyro[::-1]), find_poses(own))
    assert wrong is not None
    assert not wrong.agrees
