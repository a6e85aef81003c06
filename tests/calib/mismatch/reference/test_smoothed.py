"""A captured motion that was smoothed before it was given away."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfiltfilt

from calib.calibration import Gravity
from calib.effects.base import Term
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER
from calib.simulation.referenced import motion_from_reference
from calib.statics import find_poses

GRAVITY, RATE = 9.80665, 120.0


@cache
def swung() -> tuple[Motion, np.ndarray, np.ndarray, np.ndarray]:
    """Return a body that a hand swings about every axis, with rests; and its path at 480 Hz."""
    rng = np.random.default_rng(8)
    time = np.arange(0.0, 48.0, 0.25 / RATE)
    envelope = np.clip(3.0 * np.sin(np.pi * time / 12.0) ** 2 - 0.6, 0.0, 1.0)
    strength = gaussian_filter1d(envelope, 0.3 * 4 * RATE)[:, None]
    strength = np.maximum(strength - 1e-3, 0.0)
    turn, away = np.zeros((2, len(time), 3))
    for frequency in rng.uniform(0.4, 3.0, 8):
        phase = 2 * np.pi * (frequency * time[:, None] + rng.random((2, 1, 3)))
        turn += 0.7 / frequency * np.sin(phase[0])
        away += 0.05 / frequency * np.sin(phase[1])
    quat = quat_from_rotvec(strength * turn)
    place = strength * away
    return motion_from_reference(time, quat, place, gravity=GRAVITY), time, quat, place


def recorded(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    return simulate(swung()[0], SensorModel(), CONSUMER, rng=rng, rate=100.0)


def captured(seed: int, *, smoothed: float = 0.0) -> ReferenceMotion:
    """Return what cameras saw; ``smoothed`` is the standard deviation of a Gaussian, s."""
    _, time, quat, place = swung()
    rng = np.random.default_rng(1000 + seed)
    shake = quat_from_rotvec(rng.normal(0.0, np.radians(0.05), (len(time[::4]), 3)))
    seen = np.hstack((quat_multiply(quat[::4], shake), place[::4]))
    seen[:, 4:] += rng.normal(0.0, 1e-4, (len(seen), 3))
    if smoothed:
        seen = gaussian_filter1d(seen, smoothed * RATE, axis=0)
    size = np.linalg.norm(seen[:, :4], axis=1, keepdims=True)
    return ReferenceMotion(time[::4], seen[:, :4] / size, seen[:, 4:])


@pytest.mark.long
def test_smoothing_is_named_alone_and_by_its_size():
    width = 0.012
    real = recorded(1)
    found = diagnose_reference(real, captured(1, smoothed=width), gravity=GRAVITY)
    named = {f.effect: f for f in found.findings}
    assert set(named) <= {"reference_smoothing", "time_offset"}
    item = named["reference_smoothing"]
    for q in item.parameters.values():
        # exp(-(width w)² / 2) = 1 - (width w)² / 2 + ..., in which the next term is a tenth.
        assert q.value == pytest.approx(width**2 / 2, rel=0.15)
    assert item.held_out is not None
    assert item.held_out.after < item.held_out.before
    # It is no part of the sensor.
    made = found.calibration(real, gravity=Gravity(GRAVITY, "given"))
    assert not made.model.terms
    assert [e.effect for e in made.events if e.effect != "time_offset"] == [item.effect]


def benched() -> tuple[Motion, np.random.Generator]:
    """Return a sensor that a hand turns from pose to pose."""
    rng = np.random.default_rng(3)
    return bench_protocol(rng, poses=14, first_pose=3.0, pose_duration=(2.0, 4.0)), rng


def low_passed(motion: Motion, rng: np.random.Generator, cutoff: float) -> ReferenceMotion:
    """Return what cameras saw through a Butterworth of second order there and back."""
    time = np.arange(0.5, motion.duration - 0.5, 1.0 / RATE)
    turning, path = motion.kinematics(time)
    assert path is not None
    shake = quat_from_rotvec(rng.normal(0.0, np.radians(0.05), (len(time), 3)))
    seen = np.hstack((quat_multiply(turning.quat, shake), path.position))
    seen[:, 4:] += rng.normal(0.0, 1e-4, path.position.shape)
    seen = sosfiltfilt(butter(2, cutoff, fs=RATE, output="sos"), seen, axis=0)
    quat = seen[:, :4] / np.linalg.norm(seen[:, :4], axis=1, keepdims=True)
    return ReferenceMotion(time, quat, seen[:, 4:])


@pytest.mark.long
@pytest.mark.parametrize("cutoff", [4.0, 6.0, 10.0])
def test_a_butterworth_both_ways_is_smoothing_and_nothing_else(cutoff: float) -> None:
    """It takes nothing with the square of the frequency: gravity, clocks and signs took its place.

    Twice of second order it leaves ``1 / (1 + (f / cutoff)^4)``.
    """
    motion, rng = benched()
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    found = diagnose_reference(real, low_passed(motion, rng, cutoff), gravity=GRAVITY)
    named = {f.effect: f for f in found.findings}
    assert set(named) <= {"reference_smoothing", "time_offset"}
    assert not found.unexplained
    item = named["reference_smoothing"]
    # What positions lost shows less: a hand that turns a sensor hardly moves it.
    size = item.parameters["orientation_fourth"].value
    assert size == pytest.approx((2 * np.pi * cutoff) ** -4, rel=0.2)


@pytest.mark.long
def test_smoothing_shows_in_a_tremor_beyond_frequencies_at_which_nothing_moves() -> None:
    """Compared was up to where hand and markers first disagreed, between turns and tremor."""
    rate, cutoff = 100.0, 15.0
    time = np.arange(0.0, 60.0, 0.25 / rate)
    rng = np.random.default_rng(21)
    tremor = sosfiltfilt(
        butter(3, [6.0, 10.0], "band", fs=4 * rate, output="sos"),
        rng.normal(size=(len(time), 6)),
        axis=0,
    )
    tremor *= np.clip(2.0 * np.sin(np.pi * time / 7.5), 0.0, 1.0)[:, None] / tremor.std()
    _, slow, turning, path = swung()
    quat, place = (make_interp_spline(slow, own, k=5)(0.4 * time) for own in (turning, path))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    quat = quat_multiply(quat, quat_from_rotvec(np.radians(0.3) * tremor[:, :3]))
    place = place + 5e-4 * tremor[:, 3:]
    motion = motion_from_reference(time, quat, place, gravity=GRAVITY)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=rate)
    shake = quat_from_rotvec(rng.normal(0.0, np.radians(0.15), (len(time[::4]), 3)))
    seen = np.hstack((quat_multiply(quat[::4], shake), place[::4]))
    seen[:, 4:] += rng.normal(0.0, 2e-4, seen[:, 4:].shape)

    def found(values: np.ndarray) -> dict[str, Finding]:
        unit = values[:, :4] / np.linalg.norm(values[:, :4], axis=1, keepdims=True)
        reference = ReferenceMotion(time[::4], unit, values[:, 4:])
        diagnosis = diagnose_reference(real, reference, gravity=GRAVITY)
        assert not diagnosis.unexplained
        return {f.effect: f for f in diagnosis.findings}

    assert set(found(seen)) <= {"time_offset"}
    named = found(sosfiltfilt(butter(2, cutoff, fs=rate, output="sos"), seen, axis=0))
    assert set(named) <= {"reference_smoothing", "time_offset"}
    size = named["reference_smoothing"].parameters["orientation_fourth"]
    warped = np.tan(np.pi * cutoff / rate) * rate / np.pi
    assert size.sigma is not None
    assert size.value == pytest.approx((2 * np.pi * warped) ** -4, abs=4 * size.sigma)


@pytest.mark.long
def test_a_sample_that_is_lost_is_found_beside_smoothing():
    """Unless motion is sharpened first: beside smoothed motion it was a gain in a window."""
    motion, rng = benched()
    moment = 0.5 * motion.duration
    model = SensorModel(terms=(Term("dropped_samples", {"count": 1.0, "moment": moment}),))
    real = simulate(motion, model, CONSUMER, rng=rng, rate=100.0)
    found = diagnose_reference(real, low_passed(motion, rng, 6.0), gravity=GRAVITY)
    named = {f.effect: f for f in found.findings}
    assert set(named) <= {"reference_smoothing", "time_offset", "dropped_samples"}
    assert not found.unexplained
    lost = named["dropped_samples"].parameters
    assert lost["count"].value == 1.0
    size = named["reference_smoothing"].parameters["orientation_fourth"].value
    assert size == pytest.approx((2 * np.pi * 6.0) ** -4, rel=0.1)


@pytest.mark.long
def test_nothing_is_smoothed_in_what_was_not():
    found = diagnose_reference(recorded(3), captured(3), gravity=GRAVITY)
    assert {f.effect for f in found.findings} <= {"time_offset"}
    assert not found.unexplained


@pytest.mark.long
def test_a_table_is_commanded_and_not_smoothed():
    real, reference = recorded(5), captured(5)
    table = ReferenceMotion(reference.time, reference.quat, fixed=True)
    seen = look_at_samples(real, find_poses(real))
    skips = [compare_reference(real, r, seen, gravity=GRAVITY)[1] for r in (reference, table)]
    assert ["reference_smoothing" in skip for skip in skips] == [False, True]


@pytest.mark.long
def test_shaking_that_markers_do_not_follow_is_no_noise_of_what_is_compared():
    """It is fast: the floor was four times what was left once the smoothing had been found."""
    real, rng = recorded(1), np.random.default_rng(51)
    moving = gaussian_filter1d(1.0 * (np.linalg.norm(real.gyro, axis=1) > 0.1), 30)[:, None]
    band = butter(4, [8.0, 25.0], "bandpass", fs=100.0, output="sos")
    shaken = moving * sosfiltfilt(band, rng.normal(size=(len(real), 6)), axis=0)
    real = replace(real, accel=real.accel + shaken[:, :3], gyro=real.gyro + 0.3 * shaken[:, 3:])
    found = diagnose_reference(real, captured(1, smoothed=0.012), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "reference_smoothing"
    assert item.held_out is not None
    assert item.held_out.noise_floor == pytest.approx(item.held_out.after, rel=0.1)
    for change in found.changes:
        assert change.noise_floor == pytest.approx(change.after, rel=0.1)
