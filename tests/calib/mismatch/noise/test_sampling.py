"""What samples do not resolve of a turn, as a covariance of its closures."""

import numpy as np
import pytest
from scipy import linalg
from scipy.special import beta

from calib.mismatch.noise.noise import estimate_levels, expected_levels, make_whitener
from calib.mismatch.noise.sampling import (
    BEND,
    BENT,
    CORNER,
    EXPECTED,
    REACH,
    STEP,
    power_of_noise,
    sampling_components,
    unforetold,
    unresolved,
)
from calib.mismatch.rows.closure import Spans, close_turns
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
    spans = Spans(time, np.array([0, len(time)]))
    closed = close(time, force, rate, up)
    noise, rows = np.full((len(time), 6), 1e-12), np.arange(5)[None]
    return sampling_components(closed, force, rate, noise, spans, rows)


def test_what_is_smooth_is_foretold_and_of_noise_a_known_share_is_not() -> None:
    at = np.arange(200.0)
    spans = Spans(at, np.array([0, 80, 200]))
    smooth = ((at / 100) ** 3 - at / 50)[:, None]
    inside = np.minimum(at - spans.start[spans.turn], spans.last[spans.turn] - at) >= REACH
    assert np.abs(unforetold(smooth, spans)[inside]).max() < 1e-12
    assert np.abs(unforetold(np.ones((200, 2)), spans)).max() < 1e-15
    # A tremor of a quarter of the sample rate is a hundredth in power of what jumps at each sample.
    tremor = [np.cos(phase * at)[:, None] for phase in (np.pi / 2, np.pi)]
    slow, fast = (np.square(unforetold(x, spans)[inside]).mean() for x in tremor)
    assert slow < 0.01 * fast
    noise = np.random.default_rng(1).normal(size=(20000, 3))
    left = unforetold(noise, Spans(np.arange(20000.0), np.array([0, 20000])))
    assert np.square(left).mean() == pytest.approx(power_of_noise(REACH), rel=0.05)


@pytest.mark.parametrize(("order", "share"), [(0, STEP), (1, CORNER), (2, BEND)])
def test_an_integral_errs_by_a_known_share_of_what_is_not_foretold(
    order: int, share: float
) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(60.0)
    spans = Spans(time, np.array([0, 60]))
    missed, off = 0.0, 0.0
    for start in 25.0 + rng.random(3000):
        # From rest, and smoothly back.
        length = 53.0 - start
        # Integral of x^m (1 - x)^6 over 0 to 1.
        exact = length ** (order + 1) * beta(order + 1, 7)
        x = np.clip((time - start) / length, 0.0, 1.0)
        signal = np.where(time > start, (length * x) ** order * (1 - x) ** 6, 0.0)
        missed += (spans.weight @ signal - (spans.bend @ signal).sum() - exact) ** 2
        off += np.square(unforetold(signal[:, None], spans)).sum()
    assert missed / off == pytest.approx(share, rel=0.1)


def test_of_a_turn_that_its_samples_resolve_nothing_is_added() -> None:
    time, force, rate, up = turn(0.01, 2.0)
    found = components(time, force, rate, up)
    names = ["rate by sampling", "force by sampling", "rate bent by sampling"]
    assert [c.name for c in found] == [*names, "force bent by sampling"]
    assert [c.expected for c in found] == [*EXPECTED.values(), *BENT.values()]
    # Where it begins, its rate bends: a velocity of some µm/s, and an angle of half a µrad.
    rate, force = (np.sqrt(c.expected * c.variance) for c in found[:2])
    assert rate[:2].max() < 6e-7
    assert rate[2:].max() < 6e-6
    assert force.max() < 2e-7


def test_what_a_sensor_feels_off_the_axis_of_a_turn_is_expected() -> None:
    """A turn pushed twice: where a push begins, the angular acceleration bends."""
    rng = np.random.default_rng(6)
    time, fine = np.arange(0.0, 1.6, 0.02), np.arange(0.0, 1.6, 1e-4)
    at, spans = np.arange(len(time)) * 200, Spans(time, np.array([0, len(time)]))
    up, still, silent = np.array([[0.0, 0.0, 1.0]]), np.zeros((len(time), 3)), np.zeros((80, 6))
    errors, expected = [], []
    for _ in range(200):
        force = np.tile([0.0, 0.0, G], (len(fine), 1))
        for begin in (0.2, 0.7) + 0.2 * rng.random(2):
            length = 0.5 + 0.2 * rng.random()
            u = np.clip((fine - begin) / length, 0.0, 1.0)
            # The second derivative of a minimum-jerk turn, 6 cm off its axis.
            push = 0.06 * (60 * u - 180 * u**2 + 120 * u**3) / length**2
            force[:, 0] += rng.normal() * push
        closed = close_turns(spans, force[at], still, up, up, gravity=G)
        errors.append(closed.residual[0, 2])
        expected.append(unresolved(closed, force[at], still, silent, spans)[0, 2])
    # Within a factor of two of what is expected before levels are estimated.
    assert 0.25 < np.square(errors).mean() / np.mean(expected) < 4.0


@pytest.mark.long
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
