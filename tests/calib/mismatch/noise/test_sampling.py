"""What samples do not resolve of a turn, as a covariance of its closures."""

import numpy as np
import pytest
from scipy import linalg

from calib.mismatch.noise.noise import estimate_levels, expected_levels, make_whitener
from calib.mismatch.noise.sampling import HALVED, UNFORETOLD, sampling_components, unforetold
from calib.mismatch.rows.closure import Spans, close_turns, integrate_half, open_ends
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.rows import Component
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from calib.types import FloatArray

from ..rows.test_closure import G, close, turn


def components(
    time: FloatArray, force: FloatArray, rate: FloatArray, up: FloatArray
) -> list[Component]:
    spans, ends = Spans(time, np.array([0, len(time)])), (up[:1], up[-1:])
    closed = close(time, force, rate, up)
    half = open_ends(integrate_half(spans, force, rate), *ends, spans.duration, gravity=G)
    noise, rows, white = np.full((len(time), 6), 1e-12), np.arange(5)[None], np.full((1, 5), 1e-12)
    left = half - closed.residual
    return sampling_components(closed, left, force, rate, noise, spans, rows, white)


def test_what_is_cubic_is_foretold_and_of_noise_a_known_share_is_not() -> None:
    at = np.arange(200.0)
    cubic = ((at / 100) ** 3 - at / 50)[:, None]
    assert np.abs(unforetold(cubic, np.array([0, 80, 200]))).max() < 1e-12
    noise = np.random.default_rng(1).normal(size=(20000, 3))
    left = unforetold(noise, np.array([0, 20000]))
    assert np.square(left).mean() == pytest.approx(UNFORETOLD, rel=0.05)
    assert not left[[0, 1, -2, -1]].any()


def test_of_a_turn_that_its_samples_resolve_nothing_is_added() -> None:
    time, force, rate, up = turn(0.01, 2.0)
    found = components(time, force, rate, up)
    assert [c.name for c in found] == ["rate by sampling", "force by sampling"]
    assert [c.expected for c in found] == [HALVED["rate"], HALVED["force"]]
    # Its white noise is 1e-12.
    assert np.all([(c.expected * c.variance).max() < 1e-13 for c in found])


def test_a_smooth_turn_is_not_taken_for_a_jolted_one() -> None:
    rng = np.random.default_rng(3)
    time, force, rate, up = turn(0.016, 2.0)
    inside = ((time > 0.05) & (time < 0.95))[:, None]
    jolts = 0.005 * inside * rng.normal(size=(len(time), 3)) * (rng.random((len(time), 1)) < 0.3)
    n, number = len(time), 6
    rates = np.concatenate([rate, *[rate + jolts] * (number - 1)])
    forces, times = np.tile(force, (number, 1)), np.concatenate([time + 9.0 * i for i in range(6)])
    spans = Spans(times, n * np.arange(number + 1))
    ends = np.repeat(up[:1], number, axis=0), np.repeat(up[-1:], number, axis=0)
    closed = close_turns(spans, forces, rates, *ends, gravity=G)
    left = open_ends(integrate_half(spans, forces, rates), *ends, spans.duration, gravity=G)
    left -= closed.residual
    white, noise = np.full((number, 5), 1e-12), np.full((len(times), 6), 1e-12)
    rows = np.arange(5 * number).reshape(number, 5)
    found, _ = sampling_components(closed, left, forces, rates, noise, spans, rows, white)
    added = found.variance.reshape(number, 5)[:, :2].sum(axis=1)
    off = np.square(unforetold(rates, spans.first)).reshape(number, -1).sum(axis=1)
    # By what its samples are off their neighbours it would have its part of what jolts do.
    assert off[0] > 0.01 * off[1]
    assert added[0] < added[1] * off[0] / off[1]


def test_jolts_move_the_rows_of_a_turn_together() -> None:
    rng = np.random.default_rng(2)
    time, force, rate, up = turn(0.016, 2.0)
    inside = ((time > 0.05) & (time < 0.95))[:, None]
    still = close(time, force, rate, up).residual[0]
    errors, allowed = [], np.zeros((5, 5))
    for _ in range(300):
        # What a sample has of a jolt that its neighbours do not see, and the turn did not go by.
        jolts = 0.3 * inside * rng.normal(size=(len(time), 3)) * (rng.random((len(time), 1)) < 0.3)
        closed = close(time, force, rate + jolts, up)
        errors.append(closed.residual[0] - still)
        allowed += components(time, force, rate + jolts, up)[0].matrix / 300
    seen = np.cov(np.array(errors).T)
    # Of one size or another, but of that form: a sum of errors of its own each row is not.
    ratio = linalg.eigvalsh(seen, allowed)
    assert ratio[-1] / ratio[0] < 4.0
    apart = linalg.eigvalsh(seen, np.diag(np.diag(allowed)))
    assert apart[-1] / apart[0] > 10.0


@pytest.mark.parametrize("seed", [4, 5])
def test_a_misalignment_is_within_its_errors_where_turns_have_jolts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hands = bench_protocol(rng, poses=24, first_pose=2.0, pose_duration=(2.0, 3.0))
    real = simulate(hands, SensorModel(), CONSUMER, rng=rng, rate=62.5)
    moving = np.linalg.norm(real.gyro, axis=1) > 0.3
    hit = moving & (rng.random(len(moving)) < 0.2)
    gyro = real.gyro + 0.5 * hit[:, None] * rng.normal(size=real.gyro.shape)
    real = Recording(real.time, real.accel, gyro, "device", temperature=real.temperature)
    problem = SelfProblem(make_grid(real, find_poses(real)), None, gravity=9.80665, full_gyro=True)
    rows = problem.rows()
    mean = np.hstack((rows.baseline, rows.nuisance))
    levels = estimate_levels(rows, mean, expected_levels(rows)).values
    whitener = make_whitener(rows, levels, rows.white_diagonal, mean[:, :0])
    design = whitener.whiten(mean)
    inverse = np.linalg.pinv(design, rcond=1e-9)
    step = inverse @ whitener.whiten(rows.residual)
    sigma = np.sqrt(np.diag(inverse @ inverse.T))
    now = problem.twin.model.gyro.parameters("gyro")
    names = [n for n in rows.names if n in now and "bias" not in n]
    at = [rows.names.index(n) for n in names]
    # The gyroscope has neither a scale factor error nor a misalignment.
    off = (np.array([now[n] for n in names]) + step[at]) / sigma[at]
    assert len(names) == 9
    assert np.sqrt(np.square(off).mean()) < 1.6
    assert sigma[at].max() > 5e-4
