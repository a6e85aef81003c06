"""Columns follow a motion that closes, and not the noise that is in the residual."""

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.noise.sensornoise import sample_noise
from calib.mismatch.rows.closure import covariance_of_turns
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.twin.residuals import closing, linearise
from calib.mismatch.twin.selfmode import SelfProblem
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from calib.statics import find_poses
from calib.types import FloatArray

from ..bench import GRAVITY
from ..bench import recording as simulated

RATE = 100.0
REST, TURN = 2.4, 0.9
NOISE = np.array([0.017, 0.0014])
BIAS = np.array([0.11, 0.25, -0.08]), np.array([0.004, -0.007, 0.002])


def turned(steps: list[FloatArray], seed: int) -> Recording:
    """Return what is turned about axes of its own and nothing else, from rest to rest."""
    x = np.arange(round(TURN * RATE)) / (TURN * RATE)
    angle, rate = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / TURN
    at, force, turning = np.eye(3), [], []

    def rest() -> None:
        force.append(np.tile(at[2], (round(REST * RATE), 1)))
        turning.append(np.zeros((round(REST * RATE), 3)))

    for step in steps:
        rest()
        frames = np.stack([at @ mat_from_rotvec(part * step) for part in angle])
        force.append(frames[:, 2])
        turning.append(np.outer(rate, step))
        at = at @ mat_from_rotvec(step)
    rest()
    rng = np.random.default_rng(seed)
    both = GRAVITY * np.concatenate(force) + BIAS[0], np.concatenate(turning) + BIAS[1]
    noisy = [v + s * rng.normal(size=v.shape) for v, s in zip(both, NOISE, strict=True)]
    time = np.arange(len(noisy[0])) / RATE
    return Recording(time, *noisy, "device")


def divided_head(seed: int) -> Recording:
    """Return 36 positions about one axis, and 36 about another that it was mounted on then."""
    round_ = [np.deg2rad(10.0) * np.eye(3)[k] for k in (1, 0) for _ in range(35)]
    return turned([*round_[:35], np.deg2rad(90.0) * np.eye(3)[2], *round_[35:]], seed)


def test_the_state_of_what_columns_follow_closes() -> None:
    recording = simulated(seed=3, poses=12)
    problem = SelfProblem(
        make_grid(recording, find_poses(recording)), None, gravity=GRAVITY, full_gyro=False
    )
    problem.rows()
    grid, twin = problem.grid, problem.twin
    linear, noise = linearise(grid, twin), sample_noise(grid)
    points, spans = grid.turns
    covariance = sum(
        covariance_of_turns(weights, noise[points][:, own], spans)
        for weights, own in zip(linear.turning, (slice(3), slice(3, 6)), strict=True)
    )
    closed = closing(grid, twin, linear, noise, covariance)
    gone = 0.0
    off = linear.state.force - closed.force, linear.state.rate - closed.rate
    for weights, change, triad in zip(
        linear.turning, off, (twin.model.accel, twin.model.gyro), strict=True
    ):
        each = np.einsum("rni,ni->nr", weights, change[points] @ triad.matrix.T)
        gone = gone + np.add.reduceat(each, spans.start)
        assert np.abs(change[grid.pose >= 0]).max() == 0.0
    left = linear.residual[linear.layout.ends]
    # All of it is noise, or the share that is about as much as noise makes.
    share = float((gone * left).sum() / np.square(left).sum())
    assert share == pytest.approx(1.0, abs=1e-6) or 0.2 < share < 1.0
    assert gone == pytest.approx(share * left, rel=1e-4, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_an_axis_that_is_kept_still_has_no_gain_of_its_own(seed: int) -> None:
    """Two mounts about two axes: the still one of each had another gain than in the other mount."""
    found = diagnose_recording(divided_head(seed), gravity=GRAVITY)
    assert found.verdict == "consistent"
