"""Orientations without positions: what the accelerometer feels while the body moves is unknown."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import Diagnosis, ReferenceMotion, diagnose_reference
from calib.mismatch.reference.conclusion import UNPLACED
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER
from calib.simulation.turntable import turntable
from calib.statics import find_poses

GRAVITY = 9.80665
SETUPS = {"time_offset", "clock_scale", "reference_misalignment"}


@cache
def motion() -> Motion:
    rng = np.random.default_rng(11)
    return bench_protocol(rng, poses=10, first_pose=2.0, pose_duration=(2.0, 4.0), tremor=0.3)


def recorded(*terms: Term, of: Motion | None = None) -> Recording:
    rng = np.random.default_rng(12)
    return simulate(of or motion(), SensorModel(terms=terms), CONSUMER, rng=rng, rate=100.0)


def captured(*, of: Motion | None = None, degrees: float = 0.3) -> ReferenceMotion:
    """Return orientations alone, as noisy as cameras or another sensor's filter leave them."""
    rng, seen = np.random.default_rng(13), of or motion()
    time = np.arange(0.0, seen.duration, 1 / 120)
    shake = quat_from_rotvec(rng.normal(0, np.radians(degrees), (len(time), 3)))
    return ReferenceMotion(time, quat_multiply(seen.kinematics(time)[0].quat, shake))


def names(found: Diagnosis) -> set[str]:
    return {f.effect for f in found.findings} - SETUPS


@pytest.mark.parametrize("degrees", [0.0, 0.3, 2.0])
@pytest.mark.long
def test_a_body_that_is_carried_about_gives_the_accelerometer_no_false_name(degrees):
    found = diagnose_reference(recorded(), captured(degrees=degrees), gravity=GRAVITY)
    assert not names(found)
    assert not found.unexplained
    assert found.verdict in ("consistent", "explained")
    assert set(UNPLACED) <= set(found.hidden)
    assert found.missing[0].startswith("positions in the reference")
    assert "only at rest" in found.summary["position"]


@pytest.mark.parametrize(
    "term",
    [
        Term("gyro_misalignment", {"mxy": 0.02}),
        Term("gyro_scale_asymmetry", {"kx": 5e-3}),
        Term("accel_cross_product", {"kx_xy": 1e-3}),
    ],
)
@pytest.mark.long
def test_what_gyroscope_and_rests_tell_is_found_without_positions(term):
    found = diagnose_reference(recorded(term), captured(), gravity=GRAVITY)
    assert names(found) == {term.effect}
    ((name, value),) = term.parameters.items()
    (item,) = (f for f in found.findings if f.effect == term.effect)
    assert item.parameters[name].value == pytest.approx(value, abs=4 * item.parameters[name].sigma)


@pytest.mark.parametrize("degrees", [0.0, 0.3])
def test_rows_of_the_accelerometer_are_of_rests_alone(degrees):
    real = recorded()
    poses = find_poses(real)
    seen = look_at_samples(real, poses)
    problem, _ = compare_reference(real, captured(degrees=degrees), seen, gravity=GRAVITY)
    rows = problem.rows()
    spans = rows.interval[np.unique(rows.segment[rows.channel < 3])]
    assert len(spans) >= 7
    start, stop = real.time[poses.start], real.time[poses.stop - 1]
    assert all(((a >= start) & (b <= stop)).any() for a, b in spans)
    # The gyroscope is judged in between too.
    assert np.ptp(rows.interval[np.unique(rows.segment[rows.channel >= 3])], axis=1).sum() > (
        0.9 * (problem.time[-1] - problem.time[0])
    )


def test_without_any_rest_the_accelerometer_is_not_judged():
    moved = make_motion("paper", rng=np.random.default_rng(0), duration=40.0, gravity=GRAVITY)
    real, reference = recorded(of=moved), captured(of=moved, degrees=0.1)
    assert not len(find_poses(real))
    found = diagnose_reference(real, reference, gravity=GRAVITY)
    assert not names(found)
    (lacks,) = found.missing
    assert "not at all" in lacks


def test_a_table_of_one_axis_is_known_by_its_profile():
    table = turntable([1.0, -2.0, 3.5], faces=["+z"])
    time = np.arange(0.0, table.duration, 0.05)
    quat = table.kinematics(time)[0].quat
    assert ReferenceMotion(time, quat).placed
    assert ReferenceMotion(time, quat.round(4)).placed
    leaning = quat_from_rotvec(np.array([[0.3, -1.0, 0.2]]))
    assert ReferenceMotion(time, quat_multiply(np.tile(leaning, (len(time), 1)), quat)).placed
    shake = np.random.default_rng(1).normal(0, np.radians(0.05), (len(time), 3))
    assert not ReferenceMotion(time, quat_multiply(quat, quat_from_rotvec(shake))).placed


def test_a_table_of_several_axes_has_to_be_said():
    table = turntable([1.0, -2.0], faces=["+z", "+x"])
    time = np.arange(0.0, table.duration, 0.05)
    reference = ReferenceMotion(time, table.kinematics(time)[0].quat)
    assert not reference.placed
    assert replace(reference, fixed=True).placed
    assert replace(reference, position=np.zeros((len(time), 3))).placed
