"""From recordings to a calibration: truth recovered, parts said, what cannot work refused."""

from dataclasses import replace

import numpy as np
import pytest

from calib.calibrate import calibrate, distinct_poses
from calib.calibration import Gravity
from calib.document import from_document, to_document
from calib.errors import InsufficientMotionError
from calib.model import SensorModel, Triad
from calib.recording import DeviceInfo, Recording
from calib.simulate import NoiseModel, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.turntable import turntable
from calib.statics import find_poses

NOISE = NoiseModel(accel_noise_density=2e-3, gyro_noise_density=2e-4)
GRAVITY = Gravity(9.80665)


def sensor(rng: np.random.Generator) -> SensorModel:
    return SensorModel(
        Triad(
            rng.normal(0, 0.2, 3), rng.normal(0, 0.02, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(
            rng.normal(0, 0.02, 3),
            rng.normal(0, 0.02, 3),
            rng.normal(0, 0.01, (3, 3)) * (1 - np.eye(3)),
        ),
    )


def bench(seed: int, poses: int = 24, rate: float = 50.0) -> tuple[SensorModel, Recording]:
    rng = np.random.default_rng(seed)
    model = sensor(rng)
    motion = bench_protocol(rng, poses=poses)
    device = DeviceInfo("simulated", "SN 1", rate=rate)
    return model, simulate(motion, model, NOISE, rng=rng, rate=rate, device=device)


def test_parameters_are_recovered_within_their_standard_errors() -> None:
    scores = []
    for seed in range(6):
        model, recording = bench(seed)
        found = calibrate(recording, gravity=GRAVITY)
        assert found.complete
        truth = model.accel.parameters("accel") | model.gyro.parameters("gyro")
        error = np.array([found.values[name] - truth[name] for name in found.names])
        scores.append(float(error @ np.linalg.solve(found.covariance, error)) / len(error))
        assert found.accel is not None
        assert found.gyro is not None
        assert len(found.accel.residuals) == 24
        assert found.temperature is not None
        assert found.noise is not None
        np.testing.assert_allclose(found.noise.accel, 2e-3, rtol=0.1)
        np.testing.assert_allclose(found.noise.gyro, 2e-4, rtol=0.1)
        assert to_document(from_document(to_document(found))) == to_document(found)
    # mean of 6 chi-squares of 21 degrees of freedom over 21: 1 ± 0.13
    assert 0.6 < np.mean(scores) < 1.5


def without(recording: Recording, keep: np.ndarray, shift: np.ndarray | float = 0.0) -> Recording:
    return Recording(
        time=(recording.time + shift)[keep],
        accel=recording.accel[keep],
        gyro=recording.gyro[keep],
        clock=recording.clock,
        device=recording.device,
    )


def test_poses_without_turns_give_the_accelerometer_and_the_gyro_bias() -> None:
    model, recording = bench(1)
    still = calibrate(recording, gravity=GRAVITY)
    assert still.poses is not None
    # nothing but the poses, each a second after the one before, as from one file a pose
    keep, shift = np.zeros(len(recording), bool), np.zeros(len(recording))
    for k, (a, b) in enumerate(still.poses.interval):
        inside = (recording.time > a) & (recording.time < b)
        keep |= inside
        shift[inside] = 2.0 * k
    found = calibrate(without(recording, keep, shift), gravity=GRAVITY)
    assert not any(name.startswith("accel") for name in found.undetermined)
    assert {f"gyro.scale_factor_error.{a}" for a in "xyz"} <= set(found.undetermined)
    assert {f"gyro.bias.{a}" for a in "xyz"} <= set(found.names)
    assert found.gyro is not None
    assert found.gyro.advice
    for axis, value in zip("xyz", model.gyro.bias, strict=True):
        name = f"gyro.bias.{axis}"
        assert abs(found.values[name] - value) < 5 * found.sigmas[name]


def test_a_turn_with_a_gap_is_left_out_and_said() -> None:
    _, recording = bench(3)
    found = calibrate(recording, gravity=GRAVITY)
    assert found.poses is not None
    gap_start, gap_stop = found.poses.interval[4, 1] + 0.3, found.poses.interval[5, 0] - 0.2
    keep = (recording.time < gap_start) | (recording.time > gap_stop)
    again = calibrate(without(recording, keep), gravity=GRAVITY)
    assert again.gyro is not None
    reasons = [e for e in again.gyro.excluded if "missing" in e.reason]
    assert len(reasons) == 1
    assert reasons[0].interval[0] < gap_start < gap_stop < reasons[0].interval[1]
    for name, sigma in again.sigmas.items():
        assert abs(again.values[name] - found.values[name]) < 4 * sigma


def test_a_turn_beyond_the_full_scale_is_left_out_and_said() -> None:
    _, recording = bench(3)
    found = calibrate(recording, gravity=GRAVITY)
    assert found.poses is not None
    fastest = int(np.argmax(np.abs(recording.gyro).max(axis=1)))
    limit = 0.93 * float(np.abs(recording.gyro[fastest]).max())
    device = replace(recording.device, gyro_full_scale=limit)
    clipped = replace(recording, gyro=np.clip(recording.gyro, -limit, limit), device=device)
    again = calibrate(clipped, gravity=GRAVITY)
    assert again.gyro is not None
    reasons = [e for e in again.gyro.excluded if "at its limit" in e.reason]
    assert any(e.interval[0] < recording.time[fastest] < e.interval[1] for e in reasons)
    for name, sigma in again.sigmas.items():
        assert abs(again.values[name] - found.values[name]) < 4 * sigma


def test_a_recording_that_only_moves_is_refused() -> None:
    time = np.arange(0, 30, 0.01)
    shake = np.stack([np.sin(7 * time), np.sin(5 * time), np.cos(3 * time)], axis=1)
    rng = np.random.default_rng(0)
    moving = Recording(
        time=time,
        accel=np.array([0, 0, 9.8]) + 4 * shake + rng.normal(0, 0.01, shake.shape),
        gyro=2 * shake + rng.normal(0, 0.001, shake.shape),
        clock="device",
    )
    with pytest.raises(InsufficientMotionError, match=r"no static pose in 29\.99 s"):
        calibrate(moving, gravity=GRAVITY)


def test_one_pose_only_is_refused() -> None:
    _, recording = bench(4, poses=1)
    with pytest.raises(InsufficientMotionError, match="one pose only"):
        calibrate(recording, gravity=GRAVITY)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"accel_method": "magic"}, "`accel_method` must be one of"),
        ({"gyro_method": "magic"}, "`gyro_method` must be one of"),
        ({"gravity": 1.0}, "`gravity` must be between"),
    ],
)
def test_wrong_arguments_name_themselves(options: dict, message: str) -> None:
    _, recording = bench(5, poses=2)
    with pytest.raises(ValueError, match=message):
        calibrate(recording, **({"gravity": GRAVITY} | options))


def test_distinct_poses_are_counted_by_direction() -> None:
    up = np.array([[0, 0, 9.8], [0.1, 0, 9.8], [0, 9.8, 0], [0, 0, -9.8]])
    assert distinct_poses(up) == 3


@pytest.mark.parametrize("faces", [("+z",), ("+x", "+y", "+z")])
def test_a_rate_table_gives_the_gyroscope_in_one_pose_or_several(faces: tuple[str, ...]) -> None:
    rng = np.random.default_rng(0)
    gyro = Triad(rng.normal(0, 0.02, 3), rng.normal(0, 0.02, 3))
    rates = (1.5, -1.5)
    motion = turntable(rates, faces=faces, offset=(0.0, 0.0, 0.0))
    recording = simulate(motion, SensorModel(gyro=gyro), NOISE, rng=rng, rate=100.0)
    rows = [[s.start + 3, s.stop - 3, 1.5] for s in motion.segments if s.kind == "spin"]
    found = calibrate(
        recording, gravity=GRAVITY, gyro_method="rate_table", options={"table_rate": rows}
    )
    for axis in (face[1] for face in faces):
        name = f"gyro.scale_factor_error.{axis}"
        assert name in found.names
        truth = gyro.parameters("gyro")[name]
        assert abs(found.values[name] - truth) < 5 * found.sigmas[name]
    assert "accel.misalignment.yx" in found.undetermined


def test_what_was_read_more_often_than_it_is_measured_counts_once() -> None:
    _, plain = bench(3)
    index = np.repeat(np.arange(len(plain)), 2)
    time = plain.time[0] + 0.5 * plain.interval * np.arange(len(index))
    twice = Recording(time, plain.accel[index], plain.gyro[index], clock="host")
    expected = calibrate(plain, gravity=GRAVITY)
    for poses in (None, find_poses(twice)):
        found = calibrate(twice, gravity=GRAVITY, poses=poses)
        error = found.covariance.diagonal() ** 0.5
        values = [(found.values[n], expected.values[n]) for n in expected.names]
        off = [abs(a - b) for a, b in values]
        assert np.all(off < 0.5 * error)
        assert error == pytest.approx(expected.covariance.diagonal() ** 0.5, rel=0.1)
