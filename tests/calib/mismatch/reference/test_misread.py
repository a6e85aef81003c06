"""A gyroscope that reads a truth's turns with the wrong sign, on other axes, or in another unit."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.axis_error import ORDERS, signed_permutation
from calib.mismatch import ReferenceMotion, diagnose_against, diagnose_reference
from calib.mismatch.reference.alignment import Alignment, align
from calib.mismatch.reference.misread import misread
from calib.mismatch.reference.mounted import mounting
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from calib.simulate import simulate
from calib.simulation.noise import CONSUMER
from calib.simulation.turntable import turntable
from tests.calib.mismatch.reference.test_against import GRAVITY, recorded, simulation

MOUNTED = mat_from_rotvec(np.array([0.7, -1.9, 0.4]))


def walked(seconds: float = 40.0, rate: float = 100.0) -> Recording:
    """Return what a sensor on a walker measures: gravity along one axis, more or less, no rest."""
    time = np.arange(0.0, seconds, 1 / rate)
    turn = np.stack([0.9 * np.sin(6.1 * time), 0.5 * np.sin(3.7 * time), 0.8 * np.sin(1.3 * time)])
    sway = np.stack([np.sin(5.3 * time), np.cos(7.7 * time), 10.0 + np.sin(12.2 * time)])
    noise = np.random.default_rng(3).normal(0.0, 0.02, (len(time), 6))
    return Recording(time, sway.T + noise[:, :3], turn.T + noise[:, 3:], "device")


def seen(real: Recording, other: Recording) -> tuple[str, dict[str, float]] | None:
    clocks = align(real.time, real.gyro, other.time, other.gyro)
    found = misread(real, RecordingTruth(other, GRAVITY), clocks, other="reference")
    if found is None:
        return None
    return found.effect, {name: q.value for name, q in found.parameters.items()}


def mounted(other: Recording) -> Recording:
    return replace(other, accel=other.accel @ MOUNTED.T, gyro=other.gyro @ MOUNTED.T)


@pytest.mark.parametrize("other", [walked(), mounted(walked())])
def test_a_walk_beside_another_imu_tells_signs_and_factors(other: Recording):
    real = walked()
    assert seen(real, other) is None
    mirrored = replace(real, gyro=real.gyro * [-1, 1, 1])
    effect, values = seen(mirrored, other)
    # Half a turn about the vertical, of which a walk does not tell, makes one of the other.
    either = [ORDERS.index(((0, 1, 2), signs)) for signs in ((-1, 1, 1), (1, -1, 1))]
    assert (effect, values["gyro_axes"] in either) == ("axis_error", True)
    effect, values = seen(replace(real, gyro=2.0 * real.gyro), other)
    assert effect == "unit_error"
    assert values["gyro"] == pytest.approx(1.0, rel=0.02)
    effect, values = seen(replace(real, accel=2.0 * real.accel), other)
    assert (effect, values["accel"]) == ("unit_error", pytest.approx(1.0, rel=0.02))


@pytest.mark.parametrize("number", range(0, len(ORDERS), 5))
def test_poses_tell_each_way_to_lay_the_axes_at_any_mounting(number: int):
    real, way = recorded(), signed_permutation(number)
    read = seen(replace(real, gyro=real.gyro @ way.T), mounted(simulation()))
    assert read == (("axis_error", {"gyro": 1.0, "gyro_axes": number}) if number else None)


def test_it_ends_the_diagnosis_and_says_what_to_mend():
    """Scale factors of -1 and of 2 took them up, and all was explained."""
    real = walked()
    mirrored = replace(real, gyro=real.gyro * [1, 1, -1])
    found = diagnose_reference(mirrored, mounted(real), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["axis_error"]
    assert "Beside the reference" in found.findings[0].sentence
    doubled = diagnose_against(replace(real, gyro=2 * real.gyro), walked(), gravity=GRAVITY)
    (finding,) = doubled.findings
    assert finding.effect == "unit_error"
    assert "reads 2" in finding.sentence


def test_a_simulation_in_degrees_is_said_to_be_the_one_that_is_off():
    """The recording was to blame, for units that its own turns show to be right."""
    other = simulation()
    degrees = replace(other, gyro=np.degrees(other.gyro))
    (finding,) = diagnose_against(recorded(), degrees, gravity=GRAVITY).findings
    assert finding.effect == "unit_error"
    assert "it is the simulation that is off: the gyroscope is in deg/s" in finding.sentence


@pytest.mark.parametrize(("rate", "arm"), [(12.0, 0.08), (26.0, 0.08), (20.0, 0.15)])
def test_more_than_gravity_off_the_axis_of_a_table_is_no_unit_and_no_axis(rate: float, arm: float):
    motion = turntable((rate,), spin=90.0, rest=8.0, ramp=4.0, offset=(arm, 0.0, 0.02))
    rng = np.random.default_rng(1)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    quat = motion.kinematics(real.time).turning.quat
    truth, same = ReferenceMotion(real.time, quat).truth(gravity=GRAVITY), Alignment(0.0, 0.0, 0.0)
    assert misread(real, truth, same, other="reference") is None
    mat, left = mounting(real, truth, same)
    assert mat[2, 2] > np.cos(np.radians(2.0))
    assert left < 0.01
    effect, values = seen_beside(replace(real, accel=2.0 * real.accel), truth)
    assert (effect, values["accel"]) == ("unit_error", pytest.approx(1.0, rel=0.05))


def seen_beside(real: Recording, truth: RecordingTruth) -> tuple[str, dict[str, float]]:
    found = misread(real, truth, Alignment(0.0, 0.0, 0.0), other="reference")
    assert found is not None
    return found.effect, {name: q.value for name, q in found.parameters.items()}
