"""One triad whose glue creeps, beside a truth: it turns against that, and the other does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import ReferenceMotion, diagnose_against, diagnose_reference
from calib.mismatch.findings.diagnosis import Diagnosis
from calib.mismatch.hypotheses.windows import TURNED
from calib.model import SensorModel
from calib.recording import CHANNELS, Recording
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel

GRAVITY = 9.80665
MOTION = bench_protocol(np.random.default_rng(4), poses=16, pose_duration=(2.5, 4.0))
BEGIN, MEMORY = 0.3 * MOTION.duration, 15.0
AXIS = 4e-3 * np.array([0.8, -0.5, 0.3])


def creeping(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    real = simulate(MOTION, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    share = 1.0 - np.exp(-np.maximum(real.time - BEGIN, 0.0) / MEMORY)
    turned = np.cross(MOTION.state(real.time).force, AXIS)
    return replace(real, accel=real.accel + share[:, None] * turned)


def beside(truth: str, seed: int) -> Diagnosis:
    real, rng = creeping(seed), np.random.default_rng(seed + 100)
    if truth == "a simulation":
        other = simulate(MOTION, SensorModel(), NoiseModel(), rng=rng, rate=160.0)
        return diagnose_against(real, other, gravity=GRAVITY)
    if truth == "another IMU":
        other = simulate(MOTION, SensorModel(), CONSUMER, rng=rng, rate=125.0)
        return diagnose_reference(real, other, gravity=GRAVITY)
    time = np.arange(0.0, MOTION.duration, 1.0 / 120.0)
    turning, path = MOTION.kinematics(time)
    assert path is not None
    off = quat_from_rotvec(rng.normal(0.0, 1e-3, (len(time), 3)))
    position = path.position + rng.normal(0.0, 2e-4, (len(time), 3))
    seen = ReferenceMotion(time, quat_multiply(turning.quat, off), position)
    return diagnose_reference(real, seen, gravity=GRAVITY)


@pytest.mark.long
@pytest.mark.parametrize("truth", ["a simulation", "motion capture", "another IMU"])
def test_glue_that_creeps_turns_one_triad(truth: str) -> None:
    found = beside(truth, seed=4)
    assert not {f.effect for f in found.findings} - {"time_offset"}
    (item,) = found.unexplained
    assert item.follows == TURNED
    assert item.channels == CHANNELS[:3]
    ((start, stop),) = item.intervals
    assert abs(start - BEGIN) < 0.5 * (MOTION.duration - BEGIN)
    assert stop > MOTION.duration - 5.0
