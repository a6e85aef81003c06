"""Samples are lost whole."""

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import Quantity
from calib.mismatch import diagnose_recording
from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.search.accepted import accept
from calib.mismatch.search.counts import counted, is_whole, parts_of_samples
from calib.mismatch.search.ranking import make_stack
from calib.statics import find_poses

from ..bench import GRAVITY, problem, recording
from .stacked import candidate


@pytest.mark.parametrize(
    ("value", "sigma", "whole"),
    [
        (1.02, 0.1, True),
        (-2.9, 0.1, True),
        (1.4, 0.05, False),
        (0.1, 0.1, False),
        (-115.0, 13.0, False),
    ],
)
def test_samples_are_lost_whole_or_not_at_all(value, sigma, whole):
    assert is_whole(Quantity(value, sigma, "samples")) is whole


@pytest.mark.parametrize(
    ("value", "sigma", "count", "known"),
    [(-2.88, 0.02, -3.0, True), (1.02, 0.0, 1.0, True), (2.1, 0.29, 2.0, False)],
)
def test_a_count_is_a_whole_number(value, sigma, count, known):
    said = counted(Quantity(value, sigma, "samples"))
    assert said.value == count
    assert (said.sigma is None) is known
    if not known:
        rng = np.random.default_rng(5)
        truth = rng.integers(-3, 8, 2_000_000)
        alike = np.abs(truth + sigma * rng.normal(size=len(truth)) - value) < 0.02
        assert said.sigma == pytest.approx(np.sqrt(np.mean((truth[alike] - count) ** 2)), rel=0.2)


@pytest.mark.parametrize(("lost", "part"), [(1.0, False), (0.4, True), (2.0, False), (0.0, True)])
def test_a_part_of_a_sample_is_no_loss(lost, part):
    rows = problem()[1].rows()
    stack = make_stack(rows, skip=(), reference=False)
    loss = candidate(stack, "dropped_samples", ("count",))
    found = accept(stack, loss, 100.0)
    rows = rows.with_residual(lost * found.columns[:, 0])
    earlier = accept(stack, candidate(stack, "accel_quadratic", ("kx",)), 100.0)
    parts = parts_of_samples(rows, [earlier, found], expected_levels(rows))
    assert parts == ([found] if part else [])


@pytest.mark.long
def test_a_gain_that_is_off_for_two_turns_is_not_the_loss_of_a_part_of_a_sample():
    real = recording(seed=6, poses=20)
    rests = find_poses(real).interval
    inside = (real.time >= rests[10, 0]) & (real.time < rests[12, 1])
    gyro = real.gyro.copy()
    gyro[inside, 2] *= 1.008
    found = diagnose_recording(replace(real, gyro=gyro), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == ("gain in a window", ("gyro.z",))
    assert "dropped_samples" not in {r.effect for r in left.rivals}
    ((start, stop),) = left.intervals
    # At rest there is nothing to be multiplied.
    assert rests[10, 1] - 1.0 < start < rests[11, 0]
    assert rests[11, 1] < stop < rests[12, 1] + 1.0
