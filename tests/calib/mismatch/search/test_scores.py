"""Evidence under levels of noise."""

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch.noise.noise import (
    expected_levels,
)
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.scores import Scores, _swap
from calib.model import SensorModel
from calib.recording import CHANNELS
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import NoiseModel

from ..bench import problem


def test_levels_beside_an_effect_are_sought_from_closures_without_it():
    _, self_mode = problem()
    rows = self_mode.rows()
    base = expected_levels(rows)
    start = _swap(rows, base, 0.1 * base, ("gyro.x",))
    for component, ratio in zip(rows.components, start / base, strict=True):
        own = component.name.split(" ")[0] not in set(CHANNELS) - {"gyro.x"}
        assert ratio == pytest.approx(0.1 if own else 1.0), component.name


def test_no_effect_is_worth_more_than_all_that_there_is_to_explain():
    """Beside a truth: low drift by means that are fitted by themselves is none by all rows.

    The rows' other half, which levels are not estimated from, was then far off, and what mended
    that by chance, a step in a turn, had more evidence than the misalignment that was left out.
    """
    rng = np.random.default_rng(1)
    motion = bench_protocol(
        rng,
        poses=8,
        first_pose=1.0,
        pose_duration=(1.5, 2.5),
        turn_duration=(0.8, 1.5),
        tremor=0.0,
        travel=0.0,
    )
    quiet = NoiseModel(accel_noise_density=3e-4, gyro_noise_density=3e-5)
    turned = Term("gyro_misalignment", {"mxy": 0.02, "myz": -0.02, "mzx": 0.02})
    real = simulate(motion, SensorModel(terms=(turned,)), quiet, rng=rng, rate=50.0)
    exact = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=50.0)
    alignment = Alignment(0.0, 0.0, float(np.mean(real.time)))
    truth = RecordingTruth(exact, 9.80665)
    rows = ComparisonProblem(real, truth, alignment, gravity=9.80665, mat_sr=np.eye(3)).rows()
    stack = make_stack(rows, skip=(), reference=True)
    scores = Scores.of(rows, stack, [], expected_levels(rows))
    base = scores.base.values
    y = scores.whitener(base, scores.contrast).project(rows.residual)
    own = np.array([c.name.startswith("gyro.y") for c in rows.components])
    for share in (1.0, 1e-2, 1e-4, 1e-6):
        low = np.where(own, share * base, base)
        every = np.ones(len(stack), bool)
        evidence = scores.at(low, scores.contrast, scores._null(low), every)
        assert evidence.max() < 0.5 * float(y @ y), share
