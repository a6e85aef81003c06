"""Faults of samples: what must be mended before anything else can be compared."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.samples.found import FROZEN, GATED, STUCK_BIT, SWAPPED
from calib.mismatch.samples.samples import look_at_samples
from calib.mismatch.samples.thin import tamed
from calib.model import SensorModel
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import NoiseModel
from calib.statics import find_poses

from ..bench import GRAVITY
from ..bench import recording as simulated


def test_a_channel_that_is_stuck_is_said_and_nothing_else() -> None:
    recording = simulated()
    for share in (1.0, 0.5):
        accel = recording.accel.copy()
        accel[: int(share * len(accel)), 2] = accel[0, 2]
        stuck = replace(recording, accel=accel)
        found = diagnose_recording(stuck, gravity=GRAVITY)
        assert found.verdict == "unexplained"
        assert not [f for f in found.findings if f.effect != "quantization"]
        assert [u.channels for u in found.unexplained] == [("accel.z",)]


def test_how_many_channels_are_stuck_is_said() -> None:
    """Of a recording in which all six were "one is stuck"."""
    recording = simulated()
    still = {t: np.tile(getattr(recording, t)[0], (len(recording), 1)) for t in ("accel", "gyro")}
    all_six = diagnose_recording(replace(recording, **still), gravity=GRAVITY)
    assert all_six.missing[-1].startswith("channels that move: all are stuck")
    one = recording.accel.copy()
    one[:, 2] = one[0, 2]
    found = diagnose_recording(replace(recording, accel=one), gravity=GRAVITY)
    assert found.missing[-1].startswith("channels that move: one is stuck")


@pytest.mark.parametrize("value", ["last", "nothing"])
def test_a_channel_that_freezes_in_two_turns_is_said_with_its_moments(value: str) -> None:
    real = simulated(rate=100.0)
    poses = find_poses(real)
    gyro, lsb = real.gyro.copy(), 5e-5
    gyro = lsb * np.round(gyro / lsb)
    moments = []
    for turn in (4, 9):
        a, b = int(poses.stop[turn]), int(poses.start[turn + 1])
        at = a + int(np.argmax(np.abs(np.diff(gyro[a:b], axis=0)[:, 1])))
        gyro[at : at + 6, 1] = gyro[at, 1] if value == "last" else 0.0
        moments.append((float(real.time[at]), float(real.time[at + 5])))
    found = diagnose_recording(replace(real, gyro=gyro), gravity=GRAVITY)
    (left,) = found.unexplained
    assert (left.channels, left.follows) == (("gyro.y",), FROZEN)
    np.testing.assert_allclose(left.intervals, moments, atol=1.5 * real.interval)
    assert not found.findings


def test_packets_that_came_in_the_wrong_order_are_said_with_their_moments() -> None:
    real = simulated(rate=100.0)
    poses, order, moments = find_poses(real), np.arange(len(real)), []
    for turn in (4, 9):
        at = int(poses.stop[turn] + poses.start[turn + 1]) // 2
        order[at : at + 10] += 10
        order[at + 10 : at + 20] -= 10
        moments.append((float(real.time[at]), float(real.time[at + 19])))
    found = diagnose_recording(
        replace(real, accel=real.accel[order], gyro=real.gyro[order]), gravity=GRAVITY
    )
    (left,) = found.unexplained
    assert (left.channels, left.follows) == (CHANNELS, SWAPPED)
    np.testing.assert_allclose(left.intervals, moments, atol=1e-9)
    assert not found.findings


COUNT = np.radians(1.0)
"""A count of a 12-bit gyroscope with a range of 2000 dps, 20 times its noise."""


def test_a_coarse_channel_that_is_constant_at_rest_is_not_stuck() -> None:
    recording = simulated()
    coarse = replace(recording, gyro=COUNT * np.round(recording.gyro / COUNT))
    seen = look_at_samples(coarse, find_poses(recording))
    assert not seen.unexplained
    assert [f.effect for f in seen.findings] == ["quantization"]
    assert seen.findings[0].parameters["gyro_lsb"].value == pytest.approx(COUNT, rel=1e-6)


def test_a_coarse_channel_that_stands_still_through_turns_is_stuck() -> None:
    recording = simulated()
    poses = find_poses(recording)
    gyro = COUNT * np.round(recording.gyro / COUNT)
    first, last = int(poses.start[5]) + 10, int(poses.stop[12]) - 10
    gyro[first:last, 1] = gyro[first, 1]
    (found,) = look_at_samples(replace(recording, gyro=gyro), poses).unexplained
    assert found.channels == ("gyro.y",)
    (start, stop) = found.intervals[0]
    assert start <= recording.time[first]
    assert stop >= recording.time[last - 1]


@pytest.mark.parametrize("seed", [3, 5])
def test_a_recording_without_noise_has_no_faults(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=16)
    made = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=100.0)
    seen = look_at_samples(made, find_poses(made))
    assert not seen.findings
    assert not seen.unexplained


def test_a_hole_in_the_time_stamps_is_not_integrated_across() -> None:
    recording = simulated()
    poses = find_poses(recording)
    middle = int(poses.stop[4] + poses.start[5]) // 2
    keep = np.ones(len(recording), bool)
    keep[middle : middle + 60] = False
    holed = Recording(
        recording.time[keep],
        recording.accel[keep],
        recording.gyro[keep],
        "device",
        temperature=None if recording.temperature is None else recording.temperature[keep],
    )
    found = diagnose_recording(holed, gravity=GRAVITY)
    assert {f.effect for f in found.findings} <= {"gyro_misalignment"}
    left = f"in 1 of {len(poses) - 1} time is missing"
    assert any(left in item for item in found.missing)


def test_what_one_axis_shows_of_the_range_is_the_range_of_all() -> None:
    recording = simulated()
    gyro = np.round(recording.gyro / 1e-4) * 1e-4
    peak = np.abs(gyro).max(axis=0)
    long = int(np.argmax(peak))
    limit = 0.8 * peak[long]
    gyro = np.clip(gyro, -limit, limit)
    short = (long + 1) % 3
    poses = find_poses(recording)
    at = int(poses.stop[2] + poses.start[3]) // 2
    gyro[at, short] = -limit
    seen = look_at_samples(replace(recording, gyro=gyro), poses)
    (finding,) = seen.findings
    assert finding.effect == "saturation"
    assert f"gyro.{'xyz'[short]}" in finding.channels
    assert seen.spoilt[at]


def test_what_one_axis_exceeds_is_no_range_of_it() -> None:
    # An amplifier of one axis that runs into its supply.
    recording = simulated()
    peak = np.abs(recording.gyro).max(axis=0)
    short, long = int(np.argmin(peak)), int(np.argmax(peak))
    gyro = recording.gyro.copy()
    limit = 0.6 * peak[short]
    gyro[:, short] = np.clip(gyro[:, short], -limit, limit)
    assert peak[long] > 1.2 * limit
    (finding,) = look_at_samples(replace(recording, gyro=gyro), find_poses(recording)).findings
    assert finding.effect == "saturation"
    assert finding.channels == (f"gyro.{'xyz'[short]}",)
    assert finding.parameters["gyro_full_scale"].value == pytest.approx(limit)


@pytest.mark.parametrize(("seed", "share"), [(36, 0.6), (4, 0.45), (12, 0.6)])
@pytest.mark.long
def test_a_rest_that_a_clipped_turn_alone_joins_to_the_others_gets_no_name(
    seed: int, share: float
) -> None:
    real = simulated(seed=seed)
    limit = share * np.abs(real.gyro).max()  # the first or the last turn's
    found = diagnose_recording(
        replace(real, gyro=np.clip(real.gyro, -limit, limit)), gravity=GRAVITY
    )
    assert [f.effect for f in found.findings] == ["saturation"]
    assert not found.unexplained


@pytest.mark.long
def test_a_value_that_no_sensor_measures_is_left_out_and_said() -> None:
    recording = simulated()
    clean = diagnose_recording(recording, gravity=GRAVITY)
    for value in (1e5, 1e12, 1e300):
        accel = recording.accel.copy()
        accel[len(accel) // 2, 0] = -value
        found = diagnose_recording(replace(recording, accel=accel), gravity=GRAVITY)
        assert [f.effect for f in found.findings] == [f.effect for f in clean.findings]
        (left,) = found.unexplained
        assert left.channels == ("accel.x",)
        assert left.intervals[0][0] == recording.time[len(accel) // 2]


def test_samples_left_out_count_as_lost() -> None:
    recording = simulated()
    lost = np.zeros(len(recording), np.int64)
    lost[[50, 51]] = 2, 3
    gyro = recording.gyro.copy()
    gyro[[0, 50, 1000, -1], 2] = 1e9
    part, what = tamed(replace(recording, gyro=gyro, lost=lost))
    assert len(part) == len(recording) - 4
    assert part.lost is not None
    assert part.lost[0] == 1
    assert part.lost[49] == 6
    assert part.lost.sum() == 8
    assert [u.channels for u in what] == [("gyro.z",)]


def test_a_bit_of_more_than_the_noise_ends_a_diagnosis_and_one_of_less_does_not() -> None:
    real = simulated(seed=1)
    lsb = GRAVITY / 8192
    counts = np.rint(real.accel / lsb).astype(np.int64)
    for bit in (7, 1):
        own = counts.copy()
        own[:, 1] &= ~(1 << bit)
        found = diagnose_recording(replace(real, accel=lsb * own), gravity=GRAVITY)
        assert found.verdict == "unexplained"
        assert not found.findings
        (left,) = found.unexplained
        assert (left.channels, left.follows) == (("accel.y",), STUCK_BIT)
        mended = any("all of their bits" in item for item in found.missing)
        assert mended == (bit == 7)


def test_a_gyroscope_that_is_set_to_zero_at_rest_is_to_be_read_as_it_is() -> None:
    real = simulated(seed=1)
    gyro = real.gyro.copy()
    gyro[np.abs(gyro) < 0.02] = 0.0
    found = diagnose_recording(replace(real, gyro=gyro), gravity=GRAVITY)
    assert found.verdict == "unexplained"
    assert not found.findings
    assert found.unexplained[-1].follows == GATED
    assert any("dead band" in item for item in found.missing)
