"""Axes that are swapped, or have the wrong sign, beside a simulation."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.axis_error import ORDERS, signed_permutation
from calib.errors import NoCommonMotionError
from calib.mismatch import diagnose_against, diagnose_reference
from calib.mismatch.reference.alignment import align
from calib.mismatch.reference.laid import laid
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from tests.calib.mismatch.reference.test_against import GRAVITY, SHOWN, recorded, simulation


def turned(recording: Recording, accel: np.ndarray, gyro: np.ndarray) -> Recording:
    return replace(recording, accel=recording.accel @ accel.T, gyro=recording.gyro @ gyro.T)


def seen_beside(real: Recording, other: Recording) -> dict[str, int]:
    return dict(laid(real, other, align(real.time, real.gyro, other.time, other.gyro)))


@pytest.mark.parametrize("number", range(len(ORDERS)))
def test_each_way_to_lay_axes_is_told_of_each_triad_alone_and_of_both(number: int):
    # A simulation in the order Q is one in which the recording shows the order Q'.
    wrong, right = signed_permutation(number).T, np.eye(3)
    for triads in ({"accel"}, {"gyro"}, {"accel", "gyro"}):
        other = turned(
            simulation(),
            wrong if "accel" in triads else right,
            wrong if "gyro" in triads else right,
        )
        expected = dict.fromkeys(triads, number) if number else {}
        assert seen_beside(recorded(), other) == expected


@pytest.mark.parametrize("angle", [5.0, 30.0, 45.0, 60.0])
def test_a_sensor_that_is_mounted_at_an_angle_has_its_axes(angle: float):
    mat = mat_from_rotvec(np.radians(angle) * np.array([0.6, 0.0, 0.8]))
    assert not seen_beside(recorded(), turned(simulation(), mat, mat))


def test_axes_that_nothing_turns_about_are_as_they_were():
    real = recorded()
    gyro = real.gyro * [0, 0, 1.0]
    other = replace(real, time=real.time + SHOWN, gyro=-gyro)
    assert seen_beside(replace(real, gyro=gyro), other) == {
        "gyro": ORDERS.index(((0, 1, 2), (1, 1, -1)))
    }


@pytest.mark.parametrize("triad", ["accel", "gyro"])
def test_the_wrong_sign_is_named_and_no_scale_factor(triad: str):
    """A scale factor of -1 took up the sign, and the two were "consistent"."""
    other = simulation()
    other = replace(other, **{triad: getattr(other, triad) * [1, 1, -1]})
    found = diagnose_against(recorded(), other, gravity=GRAVITY)
    (finding,) = found.findings
    assert finding.effect == "axis_error"
    assert finding.channels == (f"{triad}.z",)
    assert "x: x, y: y, z: -z" in finding.sentence
    assert found.missing == ("units and axes that are right: mend that and diagnose again",)


@pytest.mark.parametrize("turn", [np.zeros(3), np.array([0.9, -2.0, 0.4])])
def test_another_imu_that_reads_gravity_downwards_is_an_error_that_says_so(turn: np.ndarray):
    """It said that half of the rotation differed: no frame has both."""
    mat = mat_from_rotvec(turn)
    other = turned(recorded(seed=3), -mat, mat)
    with pytest.raises(NoCommonMotionError, match="opposite signs: an accelerometer at rest"):
        diagnose_reference(recorded(), other, gravity=GRAVITY)


def test_gravity_with_the_other_sign_is_said_in_words():
    other = replace(simulation(), accel=-simulation().accel)
    (finding,) = diagnose_against(recorded(), other, gravity=GRAVITY).findings
    assert "reads 1 g upwards, and not downwards" in finding.sentence


@pytest.mark.parametrize("angle", [4.0, 11.0, 90.0, 150.0])
def test_a_mounting_at_any_angle_is_one_finding_with_its_rotation(angle: float):
    """Of 4 degrees products of two angles were a `gyro_misalignment`, and 30 another motion."""
    turn = np.radians(angle) * np.array([-0.48, -0.36, 0.8])
    mat = mat_from_rotvec(turn)
    found = diagnose_against(recorded(), turned(simulation(), mat, mat), gravity=GRAVITY)
    assert found.verdict == "explained"
    (finding,) = found.findings
    assert finding.effect == "reference_misalignment"
    for value, true in zip(finding.parameters.values(), turn, strict=True):
        assert value.sigma < 2e-4
        assert abs(value.value - true) < 4.0 * value.sigma
