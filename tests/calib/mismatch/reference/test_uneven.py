"""Times that are uneven, and right: a sensor is polled, frames are on the ticks of a clock."""

import numpy as np
import pytest

from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.reference.band import widened
from calib.mismatch.reference.filters import smoothed
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665


def uneven(rng: np.random.Generator, duration: float, rate: float, jitter: float) -> np.ndarray:
    """Return times (s) that scatter by a share of the interval about even ones."""
    even = np.arange(0.02, duration - 0.02, 1.0 / rate)
    return even + np.clip(rng.normal(0.0, jitter, len(even)), -0.4, 0.4) / rate


def captured(rng: np.random.Generator, motion, time: np.ndarray) -> ReferenceMotion:
    turning, path = motion.kinematics(time)
    shake = quat_from_rotvec(rng.normal(0.0, 1e-3, (len(time), 3)))
    position = path.position + rng.normal(0.0, 2e-4, (len(time), 3))
    return ReferenceMotion(time - 5.0, quat_multiply(turning.quat, shake), position)


@pytest.mark.parametrize("gap", [False, True])
def test_a_filter_does_the_same_to_a_signal_at_uneven_times(gap: bool) -> None:
    rng = np.random.default_rng(3)
    time = uneven(rng, 30.0, 100.0, 0.1)
    if gap:
        time = time[(time < 14.0) | (time > 15.0)]
    slow, fast = np.sin(2 * np.pi * 1.3 * time), np.sin(2 * np.pi * 20.0 * time)
    out = smoothed(time, np.stack((slow, slow + fast), axis=1), 6.0)
    # Bridges and ends are bent by what is missing there.
    inner = (time > 1.0) & (time < 29.0) & ((time < 13.0) | (time > 16.0))
    np.testing.assert_allclose(out[inner, 0], slow[inner], atol=2e-4)
    assert np.sqrt(np.mean(np.square(out[inner, 1] - slow[inner]))) < 2e-3


def test_steps_that_scatter_are_no_gaps_and_gaps_are() -> None:
    rng = np.random.default_rng(6)
    time = uneven(rng, 60.0, 100.0, 0.25)
    assert (np.diff(time) > 0.015).any()
    for kept, gap in ((np.ones(len(time), bool), False), (np.abs(time - 30.0) > 0.04, True)):
        still = np.zeros((kept.sum(), 3))
        recording = Recording(time[kept], still, still, "host")
        bad = widened(recording, 10.0, None)
        inner = np.abs(recording.time - 30.0) < 28.0
        assert bad[inner].any() == gap
        assert bad[inner].mean() < 0.05


def test_a_reference_at_uneven_times_is_seen_at_even_ones() -> None:
    rng = np.random.default_rng(4)
    motion = bench_protocol(rng, poses=6)
    time = uneven(rng, motion.duration, 120.0, 0.1)
    turning, path = motion.kinematics(time)
    assert path is not None
    seen = ReferenceMotion(time, turning.quat.copy(), path.position)
    seen.quat[400:440] = np.nan
    even = seen.regular()
    assert np.diff(even.time).std() < 1e-9
    assert np.isclose(even.known.mean(), 1.0 - 40 / len(time), atol=2e-3)
    true, where = motion.kinematics(even.time[even.known])
    assert where is not None
    same = np.abs(np.einsum("ij,ij->i", true.quat, even.quat[even.known]))
    assert (1.0 - same).max() < 1e-7
    assert even.position is not None
    np.testing.assert_allclose(even.position[even.known], where.position, atol=1e-5)
    assert even.regular() is even


@pytest.mark.long
@pytest.mark.parametrize(("sensor", "frames"), [(0.1, 0.0), (0.0, 0.08), (0.1, 0.08)])
def test_uneven_times_have_no_name_beside_markers(sensor: float, frames: float) -> None:
    rng = np.random.default_rng(5)
    motion = bench_protocol(rng, poses=20)
    time = uneven(rng, motion.duration, 100.0, sensor)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, time=time)
    seen = captured(rng, motion, uneven(rng, motion.duration, 120.0, frames))
    found = diagnose_reference(real, seen, gravity=GRAVITY)
    assert {f.effect for f in found.findings} <= {"time_offset"}
    assert not found.unexplained
