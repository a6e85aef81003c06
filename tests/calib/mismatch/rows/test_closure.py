"""Closures of turns from samples alone."""

import numpy as np

from calib.mismatch.rows.closure import (
    Closures,
    Spans,
    close_turns,
    integrate_turns,
)
from calib.rotation import mat_from_rotvec
from calib.types import FloatArray

G = 9.80665


def turn(step: float, angle: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return time, force, rate and share of a turn of 1 s about a fixed axis, gravity alone."""
    time = np.arange(-5, round(1 / step) + 6) * step
    u = np.clip(time, 0, 1)
    share = u**3 * (10 - 15 * u + 6 * u**2)
    axis = np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
    rate = angle * (30 * u**2 * (1 - u) ** 2)[:, None] * axis
    up = mat_from_rotvec(-angle * share[:, None] * axis) @ [0.0, 0.0, 1.0]
    return time, G * up, rate, up


def close(time: FloatArray, force: FloatArray, rate: FloatArray, up: FloatArray) -> Closures:
    """Return the closure of one turn."""
    spans = Spans(time, np.array([0, len(time)]))
    return close_turns(spans, force, rate, up[:1], up[-1:], gravity=G)


def test_a_brisk_turn_closes_at_50_hz() -> None:
    for angle in (1.0, 2.0, 3.0):
        time, force, rate, up = turn(0.02, angle)
        closed = close(time, force, rate, up)
        assert np.abs(closed.residual[0, :2]).max() < 1e-6
        # A trapezoid leaves 1 to 3 mm/s.
        assert np.abs(closed.residual[0, 2:]).max() < 2e-4


def test_means_over_the_sample_interval_leave_what_the_rows_allow() -> None:
    time, force, rate, up = turn(0.001, 2.0)
    width = 20
    few = len(time) // width * width

    def mean(values: FloatArray) -> FloatArray:
        return values[:few].reshape(-1, width, *values.shape[1:]).mean(axis=1)

    closed = close(mean(time), mean(force), mean(rate), up)
    step = 0.02
    curve = np.gradient(np.gradient(np.hstack((force, rate)), time, axis=0), time, axis=0)
    blur = mean(curve) * step**2 / 24
    expected = sum(
        np.einsum("rnc,nc->r", weights, blur[:, part])
        for weights, part in ((closed.accel_weights, slice(3)), (closed.gyro_weights, slice(3, 6)))
    )
    # Samples that are points would have left nothing: the difference is that of the means.
    assert np.abs(closed.residual[0, 2:]).max() > 5e-4
    assert np.abs(closed.residual[0, 2:] - expected[2:]).max() < 0.5 * np.abs(expected[2:]).max()


def test_turns_end_together_where_each_does_alone() -> None:
    turns = [turn(step, angle) for step, angle in ((0.02, 2.0), (0.01, -1.0), (0.02, 0.5))]
    first = np.append(0, np.cumsum([len(time) for time, *_ in turns]))
    # Each on its own clock: what lies between them counts for nothing.
    spans = Spans(np.concatenate([10.0 * i + time for i, (time, *_) in enumerate(turns)]), first)
    signals = (
        np.concatenate([force for _, force, _, _ in turns]),
        np.concatenate([rate for _, _, rate, _ in turns]),
    )
    ended = integrate_turns(spans, *signals)
    ups = np.stack([up[0] for *_, up in turns]), np.stack([up[-1] for *_, up in turns])
    both = close_turns(spans, *signals, *ups, gravity=G)
    for i, (time, force, rate, up) in enumerate(turns):
        closed = close(time, force, rate, up)
        left = ended.velocity[i] - G * (time[-1] - time[0]) * up[0]
        np.testing.assert_allclose(left, closed.residual[0, 2:], atol=1e-12)
        np.testing.assert_allclose(ended.frame[i] @ up[-1], up[0], atol=1e-6)
        own = slice(first[i], first[i + 1])
        for name in ("accel_weights", "gyro_weights"):
            np.testing.assert_allclose(
                getattr(both, name)[:, own], getattr(closed, name), atol=1e-12
            )
        for name in ("residual", "before", "after", "angle", "effort"):
            np.testing.assert_allclose(getattr(both, name)[i], getattr(closed, name)[0], atol=1e-12)


def test_what_errors_of_the_signals_do_is_what_the_weights_say() -> None:
    time, force, rate, up = turn(0.01, 2.0)
    rng = np.random.default_rng(3)
    u = np.clip(time, 0, 1)[:, None]
    wrong = 1e-6 * np.sin(np.pi * u) ** 2 * rng.normal(size=6)
    still = close(time, force, rate, up)
    moved = close(time, force + wrong[:, :3], rate + wrong[:, 3:], up)
    expected = np.einsum("rnc,nc->r", still.accel_weights, wrong[:, :3])
    expected += np.einsum("rnc,nc->r", still.gyro_weights, wrong[:, 3:])
    np.testing.assert_allclose(
        moved.residual[0] - still.residual[0], expected, rtol=1e-3, atol=1e-10
    )


def test_a_trembling_turn_closes_where_samples_are_uneven() -> None:
    rng = np.random.default_rng(8)
    time, _, rate, _ = turn(0.001, 2.0)
    axis = rate[500] / np.linalg.norm(rate[500])
    u = np.clip(time, 0, 1)
    angle = 2.0 * u**3 * (10 - 15 * u + 6 * u**2)
    angle += 0.01 * np.sin(np.pi * u) ** 2 * np.sin(18 * np.pi * u)
    rate = np.gradient(angle, time, edge_order=2)[:, None] * axis
    up = mat_from_rotvec(-angle[:, None] * axis) @ [0.0, 0.0, 1.0]
    errors = []
    for _ in range(20):
        kept = 10 * np.arange(1, len(time) // 10)
        kept = np.concatenate(([0], kept + rng.integers(-2, 3, len(kept)), [len(time) - 1]))
        errors.append(close(time[kept], G * up[kept], rate[kept], up[kept]).residual[0])
    off = np.sqrt(np.square(errors).mean(axis=0))
    # Slopes of the second order, and trapezoids of velocity, leave twice as much.
    assert off[:2].max() < 7e-6
    assert off[2:].max() < 3.5e-5
