"""Turns that are sampled too slowly: a hand trembles as fast as they are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from calib.mismatch.engine import diagnose_recording
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.search.aliased import tells_nothing
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import GRAVITY


@cache
def recorded(rate: float, *, tremor: float = 1.0, askew: float = 0.0) -> Recording:
    rng = np.random.default_rng(8)
    hands = bench_protocol(
        rng, poses=25, turn_duration=(0.6, 1.5), pose_duration=(3.0, 5.0), tremor=tremor
    )
    matrix = askew * (np.ones((3, 3)) - np.eye(3))
    model = SensorModel(gyro=Triad(misalignment=matrix))
    return simulate(hands, model, CONSUMER, rng=rng, rate=rate)


def judged(recording: Recording) -> bool:
    grid = make_grid(recording, find_poses(recording))
    problem = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    return tells_nothing(problem.rows())


def test_ten_samples_a_second_do_not_resolve_a_trembling_hand() -> None:
    assert judged(recorded(10.0))
    assert not judged(recorded(25.0))


def test_a_fixture_does_not_tremble_nor_is_a_gyroscope_that_is_askew_sampled_too_slowly() -> None:
    assert not judged(recorded(10.0, tremor=0.0))
    assert not judged(recorded(25.0, askew=0.05))


@pytest.mark.long
def test_rests_alone_are_judged_then() -> None:
    found = diagnose_recording(recorded(10.0), gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert any(text.startswith("faster samples: at 10 Hz") for text in found.missing)
