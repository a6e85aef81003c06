"""A recording against a reference: another IMU on the same body, motion capture, a table."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.effects.base import Term
from calib.errors import NoCommonMotionError
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.reference.band import BEYOND, limited
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.reference.sized import SCALE
from calib.mismatch.reference.upright import turn_up
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import mat_from_rotvec, quat_from_rotvec, quat_multiply, rotate
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.motions import pendulum
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.simulation.turntable import turntable
from calib.statics import find_poses

GRAVITY = 9.80665
LOWER = np.tril(np.ones((3, 3)), -1)
ARM = {"rx": 0.019, "ry": -0.012, "rz": 0.004}


@cache
def motion() -> Motion:
    rng = np.random.default_rng(1)
    return bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0), tremor=0.3)


def recorded(*terms: Term, rate: float = 50.0, seed: int = 2, offset: float = 0.0) -> Recording:
    rng = np.random.default_rng(seed)
    sampling = Sampling(clock_offset=offset)
    model = SensorModel(terms=terms)
    return simulate(motion(), model, CONSUMER, rng=rng, rate=rate, sampling=sampling)


def named(found) -> dict[str, dict[str, object]]:
    return {item.effect: dict(item.parameters) for item in found.findings}


def captured(*, start: float, rate: float = 120.0) -> ReferenceMotion:
    time = np.arange(0.0, motion().duration, 1.0 / rate)
    turning, path = motion().kinematics(time)
    assert path is not None
    quat = turning.quat.copy()
    quat[500:530] = np.nan
    return ReferenceMotion(time + start, quat, path.position)


def test_the_arm_between_two_imus_on_a_body_is_found():
    found = diagnose_reference(
        recorded(Term("accel_lever_arm", ARM)), recorded(seed=3, rate=64.0), gravity=GRAVITY
    )
    assert set(named(found)) == {"accel_lever_arm"}
    for name, value in ARM.items():
        q = named(found)["accel_lever_arm"][name]
        assert q.value == pytest.approx(value, abs=4 * q.sigma + 1e-4)
    held = found.findings[0].held_out
    assert held is not None
    assert held.after < held.before
    seen = found.findings[0].evidence
    assert seen is not None
    assert seen.x_unit == "1/s²"
    first = seen.series[0]
    assert np.square(first.before).sum() > 9 * np.square(first.after).sum()
    # Nor have the other one's errors, or a scale factor of what the arm makes it feel, taken it up.
    force = found.changes[0]
    assert force.before > 3 * force.after
    assert force.after == pytest.approx(force.noise_floor, rel=0.15)
    assert found.log_likelihood is not None
    assert found.log_likelihood[1] > found.log_likelihood[0] + 100


def test_two_imus_that_are_mounted_at_an_angle_and_start_apart():
    real, other = recorded(), recorded(seed=3, rate=64.0, offset=12.0)
    turn = mat_from_rotvec(np.array([0.02, -0.01, 1.5]))
    other = Recording(other.time, other.accel @ turn.T, other.gyro @ turn.T, "device")
    found = named(diagnose_reference(real, other, gravity=GRAVITY))
    assert set(found) == {"reference_misalignment", "time_offset"}
    assert found["time_offset"]["delay"].value == pytest.approx(-12.0, abs=1e-3)
    size = np.linalg.norm([found["reference_misalignment"][f"r{a}"].value for a in "xyz"])
    assert size == pytest.approx(np.linalg.norm([0.02, -0.01, 1.5]), abs=2e-3)


def test_two_alike_imus_are_consistent():
    found = diagnose_reference(recorded(), recorded(seed=3, rate=64.0), gravity=GRAVITY)
    assert found.verdict == "consistent"


@pytest.mark.long
def test_what_scatter_of_stamps_does_is_nothing_of_the_sensor():
    rng = np.random.default_rng((11, 0))
    real, other = recorded(rate=56.0), recorded(seed=3, rate=200.0, offset=12.0)
    scatter = np.clip(rng.normal(0, 0.3, len(real)), -0.4, 0.4) / 56.0
    shown = replace(real, time=real.time + scatter, clock="host")
    found, even = (diagnose_reference(r, other, gravity=GRAVITY) for r in (shown, real))
    assert set(named(found)) == set(named(even))
    assert found.verdict == even.verdict == "explained"
    delay = named(found)["time_offset"]["delay"]
    assert abs(delay.value + 12.0) < 4.0 * delay.sigma


@pytest.mark.parametrize("inverse", [False, True])
def test_motion_capture_with_a_gap_gives_arm_and_delay(inverse):
    reference = captured(start=0.02)
    if inverse:
        reference = reference.inverted()
    found = diagnose_reference(recorded(Term("accel_lever_arm", ARM)), reference, gravity=GRAVITY)
    got = named(found)
    assert {"accel_lever_arm", "time_offset"} <= set(got)
    assert got["time_offset"]["delay"].value == pytest.approx(-0.02, abs=1e-3)
    for name, value in ARM.items():
        assert got["accel_lever_arm"][name].value == pytest.approx(value, abs=1e-3)


@pytest.mark.parametrize(
    ("up", "inverse"),
    [
        ("y", False),
        pytest.param("-x", True, marks=pytest.mark.long),
        pytest.param("0.60, 0.64, 0.48", False, marks=pytest.mark.long),
        pytest.param("0.60, 0.64, 0.48", True, marks=pytest.mark.long),
    ],
)
def test_another_axis_of_the_world_may_be_up(up, inverse):
    """Some systems have y up: the same is found as beside one with z up."""
    axes = {"y": [0.0, 1.0, 0.0], "-x": [-1.0, 0.0, 0.0]}
    turn = turn_up(np.array(axes.get(up, [0.6, 0.64, 0.48])))[None] * [1.0, -1.0, -1.0, -1.0]
    seen = captured(start=0.02)
    assert seen.position is not None
    seen = replace(seen, quat=quat_multiply(turn, seen.quat), position=rotate(turn, seen.position))
    reference = seen.inverted() if inverse else seen
    found = diagnose_reference(recorded(Term("accel_lever_arm", ARM)), reference, gravity=GRAVITY)
    assert found.summary["up"] == up
    got = named(found)
    assert {"accel_lever_arm", "time_offset"} <= set(got)
    assert set(got) <= {
        "accel_lever_arm",
        "time_offset",
        *([] if up in axes else ["reference_tilt"]),
    }
    for name, value in ARM.items():
        assert got["accel_lever_arm"][name].value == pytest.approx(value, abs=1e-3)


@pytest.mark.parametrize(("rate", "share"), [(60.0, 0.05), (120.0, 0.15), (240.0, 0.3)])
def test_orientations_that_are_missing_here_and_there_are_bridged(rate, share):
    """To a tenth of a sensor's noise; a hole of a quarter of a second is left out."""
    whole = captured(start=0.0, rate=rate)
    missing = np.random.default_rng(4).random(len(whole.time)) < share
    torn = replace(whole, quat=np.where(missing[:, None], np.nan, whole.quat))
    truth, time = torn.truth(gravity=GRAVITY), np.arange(1.0, 30.0, 0.01)
    known, state, true = truth.covers(time), truth.state(time), motion().state(time)
    hole = (time > 500 / rate) & (time < 530 / rate)
    assert known.mean() > 0.7
    assert not known[hole].any()
    off = [(state.rate - true.rate)[known], (state.force - true.force)[known]]
    noise = CONSUMER.gyro_noise_density, CONSUMER.accel_noise_density
    for error, density in zip(off, noise, strict=True):
        assert np.sqrt(np.mean(np.square(error))) < 0.1 * density * np.sqrt(50.0)


@pytest.mark.parametrize(("rate", "other"), [(50.0, 60.0), (50.0, 200.0), (100.0, 60.0)])
@pytest.mark.parametrize("bandwidth", [None, 5.0, 15.0])
def test_what_a_captured_motion_predicts_is_what_a_sensor_feels(rate, other, bandwidth):
    """Without noise the differences are far below that of a consumer part, at any two rates."""
    rng = np.random.default_rng(2)
    real = simulate(motion(), SensorModel(), NoiseModel(), rng=rng, rate=rate)
    first = None if bandwidth is None or BEYOND * bandwidth > 0.5 * other else BEYOND * bandwidth
    bands = None if first is None else (first, first)
    truth = captured(start=0.0, rate=other).truth(gravity=GRAVITY, bands=bands)
    spoilt = np.zeros(len(real), bool)
    if bandwidth is not None:
        common = limited(real, truth, bandwidth, spoilt)
        real, truth, spoilt = common.real, common.truth, common.spoilt
    known = truth.covers(real.time) & ~spoilt
    state = truth.state(real.time)
    noise = np.sqrt(bandwidth or 0.5 * rate)
    accel = (real.accel - state.force)[known] / (CONSUMER.accel_noise_density * noise)
    gyro = (real.gyro - state.rate)[known] / (CONSUMER.gyro_noise_density * noise)
    assert known.mean() > 0.8
    assert np.sqrt(np.mean(accel**2)) < 0.1
    assert np.sqrt(np.mean(gyro**2)) < 0.1


def test_a_low_pass_takes_as_much_of_what_an_arm_feels_as_of_all_else():
    """Of the square of a rate it leaves less than the square of what it leaves of the rate."""
    arm = np.array([0.5, 0.0, 0.0])
    lever = SensorModel(terms=(Term("accel_lever_arm", {"rx": 0.5}),))
    rng = np.random.default_rng(2)
    real = simulate(motion(), lever, NoiseModel(), rng=rng, rate=100.0)
    spoilt = np.zeros(len(real), bool)
    common = limited(real, captured(start=0.0).truth(gravity=GRAVITY), 5.0, spoilt)
    state = common.truth.state(common.real.time)
    known = common.truth.covers(common.real.time) & ~common.spoilt
    left = (common.real.accel - state.force - state.gradient @ arm)[known]
    of_limited = (
        common.real.accel - state.force - replace(state, known_gradient=None).gradient @ arm
    )[known]
    assert np.sqrt(np.mean(left**2)) < 0.1 * CONSUMER.accel_noise_density * np.sqrt(5.0)
    assert np.sqrt(np.mean(of_limited**2)) > 10 * np.sqrt(np.mean(left**2))


@pytest.mark.long
def test_half_a_metre_from_what_is_captured_there_is_an_arm_and_no_other_gravity():
    rng = np.random.default_rng(4)
    real = recorded(Term("accel_lever_arm", {"rx": 0.5}), rate=104.0)
    exact = captured(start=0.0)
    shake = quat_from_rotvec(rng.normal(0, np.radians(0.1), (len(exact.time), 3)))
    assert exact.position is not None
    noisy = ReferenceMotion(
        exact.time,
        quat_multiply(exact.quat, shake),
        exact.position + rng.normal(0, 2e-4, exact.position.shape),
    )
    found = diagnose_reference(real, noisy, gravity=GRAVITY)
    assert set(named(found)) == {"accel_lever_arm"}
    # Chance alone may say something, at p = 0.01.
    assert min((u.p_value for u in found.unexplained), default=1.0) > 1e-3


@pytest.mark.long
@pytest.mark.parametrize(("error", "possible"), [(0.08, True), (2.0, False)])
def test_gravity_is_not_what_it_is_nowhere_on_earth(error, possible):
    """What mimics another gravity that no place has is said otherwise, or not explained."""
    real = recorded(Term("gravity_magnitude", {"error": error}))
    found = diagnose_reference(real, captured(start=0.0), gravity=GRAVITY)
    assert ("gravity_magnitude" in named(found)) == possible
    assert found.findings or found.unexplained


@pytest.mark.long
@pytest.mark.parametrize(("scale", "assumed"), [(0.99, GRAVITY), (1.0, GRAVITY - 0.08)])
def test_the_scale_of_positions_is_the_rival_of_another_gravity(scale, assumed):
    """The better one, if no place on Earth has it."""
    exact = captured(start=0.0)
    assert exact.position is not None
    seen = replace(exact, position=scale * exact.position)
    found = diagnose_reference(recorded(), seen, gravity=assumed)
    (item,) = [f for f in found.findings if f.effect == "gravity_magnitude"]
    assert item.rivals[0].effect == SCALE
    assert "a rod" in item.to_separate
    lack = [m for m in found.missing if m.startswith("positions in metres")]
    assert (item.rivals[0].odds > 1.0) == bool(lack) == (scale != 1.0)


def test_noise_of_angles_makes_no_slow_force_of_the_noise_of_positions():
    """A product of both has any frequency, and half of it a low-pass of the force lets through."""
    rng, rate = np.random.default_rng(7), 200.0
    exact = captured(start=0.0, rate=rate)
    assert exact.position is not None
    shake = quat_from_rotvec(rng.normal(0, np.radians(0.1), (len(exact.time), 3)))
    noisy = ReferenceMotion(
        exact.time,
        quat_multiply(exact.quat, shake),
        exact.position + rng.normal(0, 2e-4, exact.position.shape),
    )
    real = simulate(motion(), SensorModel(), NoiseModel(), rng=rng, rate=100.0)
    slow = []
    for bands in (None, (BEYOND * 5.0, BEYOND * 5.0), (BEYOND * 5.0, 45.0)):
        truth = noisy.truth(gravity=GRAVITY, bands=bands)
        common = limited(real, truth, 5.0, np.zeros(len(real), bool))
        known = common.truth.covers(common.real.time) & ~common.spoilt
        left = (common.real.accel - common.truth.state(common.real.time).force)[known]
        # Means over a second, as where an effect is slow.
        slow.append(left[: len(left) // 30 * 30].reshape(-1, 30, 3).mean(axis=1).std())
    assert slow[1] < 0.7 * slow[0]
    assert slow[2] < 0.7 * slow[0]


@pytest.mark.long
def test_a_sensor_with_errors_off_the_centre_of_a_table_has_an_arm_and_nothing_else():
    """What turning makes it feel is misaligned and scaled as all else; the height stays open."""
    arm = (0.08, 0.0, 0.02)
    table = turntable([1.0, -2.0, 3.5, -5.0], offset=arm)
    model = SensorModel(
        Triad(np.array([0.1, -0.2, 0.1]), np.array([0.01, -0.01, 0.005]), 0.01 * LOWER),
        Triad(np.array([0.01, 0.0, -0.01]), np.array([0.005, 0.01, -0.01])),
    )
    rng = np.random.default_rng(5)
    real = simulate(table, model, CONSUMER, rng=rng, rate=50.0)
    time = np.arange(0.0, table.duration, 1 / 20)
    reference = ReferenceMotion(time - 9.0, table.kinematics(time)[0].quat)
    found = diagnose_reference(real, reference, gravity=GRAVITY)
    assert set(named(found)) == {"time_offset", "accel_lever_arm"}
    assert not found.unexplained
    for name, value in zip(("rx", "ry", "rz"), arm, strict=True):
        q = named(found)["accel_lever_arm"][name]
        assert abs(q.value - value) < 3.5 * q.sigma, name
    assert named(found)["accel_lever_arm"]["rx"].sigma < 0.005
    assert named(found)["accel_lever_arm"]["rz"].sigma > 0.1


@pytest.mark.long
def test_what_axes_that_never_turn_would_have_upsets_nothing():
    """Their columns are rounding errors: the arm stays, and only what turns has a parameter."""
    arm = (0.08, -0.05, 0.02)
    table = turntable([3.5, -1.7, 0.9, -3.5], offset=arm)
    model = SensorModel(terms=(Term("gyro_scale_quadratic", {"kz": 5e-5}),))
    rng = np.random.default_rng(5)
    real = simulate(table, model, CONSUMER, rng=rng, rate=50.0)
    time = np.arange(0.0, table.duration, 1 / 20)
    reference = ReferenceMotion(time - 9.0, table.kinematics(time)[0].quat)
    found = named(diagnose_reference(real, reference, gravity=GRAVITY))
    assert set(found) == {"time_offset", "accel_lever_arm", "gyro_scale_quadratic"}
    assert set(found["gyro_scale_quadratic"]) == {"kz"}
    for name, value in (("rx", arm[0]), ("ry", arm[1])):
        q = found["accel_lever_arm"][name]
        assert abs(q.value - value) < 3.5 * q.sigma, name
        assert q.sigma < 0.005


@pytest.mark.long
def test_a_lost_sample_is_counted_in_samples_of_the_recording():
    """Beside noisy captured motion every third sample of it is compared."""
    rng = np.random.default_rng(6)
    turn = motion().turns[3]
    real = recorded(
        Term("dropped_samples", {"count": -4.0, "moment": float(turn.mean())}), rate=200.0
    )
    seen = captured(start=5.0)
    assert seen.position is not None
    noise = quat_from_rotvec(rng.normal(0, np.radians(0.05), (len(seen.time), 3)))
    position = seen.position + rng.normal(0, 1e-4, seen.position.shape)
    reference = ReferenceMotion(seen.time, quat_multiply(seen.quat, noise), position)
    found = diagnose_reference(real, reference, gravity=GRAVITY)
    assert found.summary["compared_samples"] < 0.5 * len(real)
    count = named(found)["dropped_samples"]["count"]
    assert count.value == pytest.approx(-4.0, abs=0.2)


@pytest.mark.long
def test_a_repeated_sample_is_one_finding_though_all_that_follows_is_late():
    turn = motion().turns[3]
    term = Term("dropped_samples", {"count": -1.0, "moment": float(turn.mean())})
    found = diagnose_reference(recorded(term), recorded(seed=3, offset=4.0), gravity=GRAVITY)
    (item,) = (f for f in found.findings if f.effect == "dropped_samples")
    assert item.parameters["moment"].value == pytest.approx(turn.mean(), abs=0.03)


@pytest.mark.long
@pytest.mark.parametrize(("count", "turn"), [(3.0, 1), (2.0, 4)])
def test_samples_lost_at_rest_are_lost_anywhere_in_it(count, turn):
    """Where the next turn sets in the line of a delay is off: it said when, to a sample."""
    at = float(motion().turns[turn][1]) + 0.8
    term = Term("dropped_samples", {"count": count, "moment": at})
    real, other = recorded(term, seed=17), recorded(seed=7, rate=100.0, offset=4.0)
    found = diagnose_reference(real, other, gravity=GRAVITY)
    (item,) = (f for f in found.findings if f.effect == "dropped_samples")
    assert item.parameters["count"].value == count
    moment = item.parameters["moment"]
    assert moment.sigma is not None
    assert abs(moment.value - at) < 3.0 * moment.sigma < 6.0


@pytest.mark.parametrize("count", [-1.0, -2.0])
@pytest.mark.long
def test_samples_repeated_at_rest_are_one_finding(count):
    at = float(motion().turns[1][1]) + 0.8
    real = recorded(Term("dropped_samples", {"count": count, "moment": at}), seed=13)
    found = diagnose_reference(real, recorded(seed=3, rate=64.0, offset=4.0), gravity=GRAVITY)
    (item,) = (f for f in found.findings if f.effect == "dropped_samples")
    assert item.parameters["count"].value == count
    assert item.parameters["moment"].value == pytest.approx(at, abs=0.03)


def test_a_reference_of_another_motion_is_an_error():
    rng = np.random.default_rng(4)
    other = bench_protocol(rng, poses=8, first_pose=4.0, pose_duration=(2.0, 6.0))
    reference = simulate(other, SensorModel(), CONSUMER, rng=rng, rate=64.0)
    with pytest.raises(NoCommonMotionError, match="same motion"):
        diagnose_reference(recorded(), reference, gravity=GRAVITY)


def test_a_reference_that_saw_nothing_says_so():
    reference = captured(start=0.0)
    blind = ReferenceMotion(reference.time, np.full_like(reference.quat, np.nan))
    with pytest.raises(NoCommonMotionError, match="rows that can be used"):
        diagnose_reference(recorded(), blind, gravity=GRAVITY)


def test_a_reference_in_other_units_says_which():
    real = recorded(seed=2)
    millimetres = captured(start=0.0)
    assert millimetres.position is not None
    wrong = ReferenceMotion(millimetres.time, millimetres.quat, 1e3 * millimetres.position)
    with pytest.raises(NoCommonMotionError, match="expected m"):
        diagnose_reference(real, wrong, gravity=GRAVITY)
    other = recorded(seed=3, rate=64.0)
    degrees = Recording(other.time, other.accel, np.degrees(other.gyro), "device")
    with pytest.raises(NoCommonMotionError, match=r"degrees|cannot be trusted"):
        diagnose_reference(real, degrees, gravity=GRAVITY)
    in_g = Recording(other.time, other.accel / GRAVITY, other.gyro, "device")
    with pytest.raises(NoCommonMotionError, match="cannot be trusted"):
        diagnose_reference(real, in_g, gravity=GRAVITY)


def test_positions_in_other_axes_are_left_out_and_it_is_said():
    right = captured(start=0.02)
    wrong = replace(right, position=right.position[:, [1, 0, 2]])
    real = recorded(Term("accel_lever_arm", ARM))
    found = diagnose_reference(real, wrong, gravity=GRAVITY)
    assert "axes" in found.missing[0]
    assert "accel_lever_arm" not in named(found)
    assert not found.unexplained
    assert not any(
        "axes" in text for text in diagnose_reference(real, right, gravity=GRAVITY).missing
    )


def test_positions_that_are_noisy_are_those_of_the_sensor():
    """They explain what is slow: their noise grows with the square of the frequency."""
    reference = captured(start=0.0)
    assert reference.position is not None
    noise = np.random.default_rng(6).normal(0, 1.5e-3, reference.position.shape)
    reference = replace(reference, position=reference.position + noise)
    found = diagnose_reference(recorded(Term("accel_lever_arm", ARM)), reference, gravity=GRAVITY)
    assert not [m for m in found.missing if "positions" in m]
    arm = named(found)["accel_lever_arm"]
    for name, value in ARM.items():
        assert arm[name].value == pytest.approx(value, abs=5 * arm[name].sigma)


def test_a_reference_of_another_time_says_that_nothing_is_common():
    real = recorded(seed=2)
    late = captured(start=0.0)
    away = late.time > 0.8 * late.time[-1]
    rest = ReferenceMotion(
        late.time[away], np.tile([1.0, 0.0, 0.0, 0.0], (int(away.sum()), 1)), None
    )
    with pytest.raises(NoCommonMotionError, match=r"does not turn|lasts"):
        diagnose_reference(real, rest, gravity=GRAVITY)


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_what_the_other_gyroscope_gets_wrong_is_no_error_of_the_accelerometer_at_an_arm(seed):
    """Nobody knows the bias of either: what an arm makes of it follows the rate, and has no name.

    Three degrees per second, and a per cent of scale, at 0.3 m.
    """
    arm = {"rx": 0.3, "ry": 0.0, "rz": 0.0}
    rng = np.random.default_rng(seed)
    wrong = Triad(rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.01, 3))
    other = simulate(motion(), SensorModel(gyro=wrong), CONSUMER, rng=rng, rate=120.0)
    real = recorded(Term("accel_lever_arm", arm), rate=104.0)
    found = diagnose_reference(real, other, gravity=GRAVITY)
    assert set(named(found)) == {"accel_lever_arm"}
    assert not found.unexplained
    q = named(found)["accel_lever_arm"]["rx"]
    assert q.value == pytest.approx(arm["rx"], abs=4 * q.sigma)


@pytest.mark.long
@pytest.mark.parametrize("turn", [0.02, 0.6])
def test_beside_an_imu_that_nobody_calibrated_an_arm_is_no_size_effect(turn):
    """What its scale factors make of gravity they do not make of what an arm feels.

    Where it lies at an angle, what turns it into the frame is bent by more than noise.
    """
    arm = {"rx": 0.05, "ry": -0.06, "rz": 0.04}
    accel, gyro = (
        Triad([bias, -bias, bias / 2], scale, 0.015 * LOWER)
        for bias, scale in ((0.5, [0.03, -0.03, 0.01]), (0.2, [-0.02, 0.03, 0.0]))
    )
    rng = np.random.default_rng(4)
    other = simulate(motion(), SensorModel(accel, gyro), CONSUMER, rng=rng, rate=64.0)
    mat = mat_from_rotvec(np.array([turn, -turn, turn]))
    other = replace(other, accel=other.accel @ mat, gyro=other.gyro @ mat)
    found = diagnose_reference(
        recorded(Term("accel_lever_arm", arm), rate=104.0), other, gravity=GRAVITY
    )
    # What its scale factors make of axes that are turned is no misalignment of the sensor. Two
    # degrees may be those of its own axes.
    turned = {"reference_misalignment"} if turn > 0.1 else set()
    assert set(named(found)) == {"accel_lever_arm"} | turned
    assert any("known better" in text for text in found.missing)
    assert not found.unexplained
    for name, value in arm.items():
        q = named(found)["accel_lever_arm"][name]
        assert q.value == pytest.approx(value, abs=3.5 * q.sigma)
        # Its scale factors are known by their limits alone, and a longer arm is the same.
        assert q.sigma > 0.005 * abs(value)


@pytest.mark.long
def test_the_cube_of_a_rate_has_no_square_beside_an_imu_with_a_bias():
    """Of twelve degrees per second: (w + b)³ has 3 b w² in it, and that one's rests show b."""
    cube = {"kx": 3e-4, "ky": -2e-4, "kz": 2e-4}
    rng = np.random.default_rng(4)
    biased = SensorModel(gyro=Triad(np.array([0.2, -0.2, 0.2])))
    other = simulate(motion(), biased, CONSUMER, rng=rng, rate=64.0)
    real = recorded(Term("gyro_scale_nonlinearity", cube), rate=104.0)
    found = diagnose_reference(real, other, gravity=GRAVITY)
    assert set(named(found)) == {"gyro_scale_nonlinearity"}


@pytest.mark.long
@pytest.mark.parametrize("name", ["swing", "spin"])
def test_turns_about_one_axis_leave_little_that_two_imus_differ_by(name):
    """There the square of a rate is nearly a force: a scale factor could be an arm's, or axes'."""
    made = {
        "swing": pendulum(amplitude=1.0, length=0.8),
        "spin": turntable([3.49, -3.49, 4.71], faces=["+z"], offset=(0.1, 0.02, 0.0), spin=20.0),
    }[name]
    rng = np.random.default_rng(1)
    sensor = SensorModel(
        Triad(rng.normal(0, 0.2, 3), rng.normal(0, 0.01, 3), 0.01 * LOWER),
        Triad(rng.normal(0, 0.01, 3), rng.normal(0, 0.01, 3)),
    )
    real = simulate(made, sensor, CONSUMER, rng=rng, rate=100.0)
    other = simulate(made, SensorModel(), CONSUMER, rng=rng, rate=64.0)
    turn = np.array([0.03, -0.02, 0.6])
    mat = mat_from_rotvec(turn)
    other = replace(other, accel=other.accel @ mat, gyro=other.gyro @ mat)
    found = diagnose_reference(real, other, gravity=GRAVITY)
    assert not {"accel_lever_arm", "accel_size_effect"} & set(named(found))
    for name, value in zip(("rx", "ry", "rz"), -turn, strict=True):
        q = named(found)["reference_misalignment"][name]
        assert abs(q.value - value) < 3.5 * q.sigma


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.long
def test_a_captured_swing_is_not_taken_for_its_mirror_image(seed):
    """To a gyroscope the other way round is the same as upside down."""
    made, rng = pendulum(amplitude=1.0, duration=60.0), np.random.default_rng(seed)
    real = simulate(made, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    time = np.arange(0.0, made.duration, 0.01)
    turning, path = made.kinematics(time)
    assert path is not None
    quat = quat_multiply(turning.quat, quat_from_rotvec(rng.normal(0.0, 2e-3, (len(time), 3))))
    seen = ReferenceMotion(time, quat, path.position + rng.normal(0.0, 2e-4, (len(time), 3)))
    samples = look_at_samples(real, find_poses(real))
    for reference in (seen, seen.inverted()):
        problem = compare_reference(real, reference, samples, gravity=GRAVITY)[0]
        assert np.abs(problem.setup.mat_sr - np.eye(3)).max() < 0.02
