"""What a sensor remembers of its turns and its loads shows beside a truth, too."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calib.effects.base import State
from calib.mismatch import diagnose_against
from calib.mismatch.hypotheses.remembered import LOADED, Stretches, lag_of, side_of
from calib.mismatch.reference.against import compare_simulation
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import with_added

GRAVITY = 9.80665


def motion(seed: int) -> Motion:
    return bench_protocol(
        np.random.default_rng(seed), poses=20, first_pose=2.0, pose_duration=(2.0, 4.0)
    )


def beside(seed: int) -> tuple[Recording, Recording, State]:
    """Return a recording, a simulation without noise, and the motion when the first was made."""
    moved, sensor = motion(seed), SensorModel()
    rng = np.random.default_rng(seed + 100)
    real = simulate(moved, sensor, CONSUMER, rng=rng, rate=50.0)
    truth = simulate(moved, sensor, NoiseModel(), rng=rng, rate=80.0)
    return real, truth, moved.state(real.time)


def test_rests_and_turns_are_those_of_the_motion() -> None:
    real, truth, _ = beside(3)
    poses = find_poses(real)
    seen = look_at_samples(real, poses)
    rows = compare_simulation(real, truth, seen, gravity=GRAVITY)[0].rows()
    assert not rows.is_rest.any()
    found = Stretches.of(rows)
    assert np.count_nonzero(found.still) == len(poses)
    assert (np.diff(found.still.astype(int)) != 0).all()
    for (a, b), first, stop in zip(
        found.interval[found.still], poses.start, poses.stop, strict=True
    ):
        # Poses begin late and end early, to be sure.
        assert a <= real.time[first] + 0.2
        assert b >= real.time[stop - 1] - 0.2
    start, stop = found.interval[found.still].T
    middle = np.searchsorted(rows.state.time, 0.5 * (start + stop))
    assert (found.pose[middle] == np.arange(len(poses))).all()


@pytest.mark.long
@pytest.mark.parametrize(
    ("channel", "made", "follows"),
    [
        ("accel.x", lambda s: 0.02 * side_of(s.force[:, 0] / GRAVITY, 0.25), LOADED),
        ("accel.z", lambda s: 0.08 * lag_of(s.force[:, 2] / GRAVITY, 0.25), LOADED),
        ("gyro.y", lambda s: 1e-3 * faded(s.rate[:, 1], s.time, 5.0), "time since the last turn"),
    ],
)
def test_what_remembers_follows_what_was_before(
    channel: str, made: Callable[[State], FloatArray], follows: str
) -> None:
    real, truth, state = beside(3)
    found = diagnose_against(with_added(real, {channel: made(state)}), truth, gravity=GRAVITY)
    assert not found.findings
    assert [(u.follows, u.channels) for u in found.unexplained] == [(follows, (channel,))]


def faded(rate: FloatArray, time: FloatArray, memory: float) -> FloatArray:
    """Return a rate through a low-pass of first order, sample by sample."""
    kept, out = float(np.exp(-(time[1] - time[0]) / memory)), [0.0]
    for value in rate[1:].tolist():
        out.append(value + kept * (out[-1] - value))
    return np.array(out)
