"""Stamps that scatter are evened out where the samples were taken evenly, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.calibrate import calibrate
from calib.mismatch import diagnose_recording
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.timing import clock_errors, even_times, evened, sample_numbers
from calib.types import FloatArray
from drivers.formats.ticks import Ticks

GRAVITY = 9.80665
TURNING = 100.0
BURSTS = ["in bursts of 4", "in bursts of 10", "in bursts of 30"]


def bench(rate: float = 100.0, *, time=None, poses: int = 10) -> Recording:
    motion = bench_protocol(np.random.default_rng(3), poses=poses)
    if time is not None:
        time = time[time < motion.duration]
    rng = np.random.default_rng(4)
    sampled = {"rate": rate} if time is None else {"time": time}
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, **sampled)


def stamps(kind: str, time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return what a computer writes down for samples that are taken at even times."""
    n, interval = len(time), time[1] - time[0]
    if kind == "jitter":
        return time + np.clip(rng.normal(0, 0.2 * interval, n), -0.4 * interval, 0.4 * interval)
    if kind == "rounded":
        return np.round(time, 3)
    if kind == "held up":
        late = rng.exponential(0.1 * interval, n)
        # Whether a computer catches up, or has lost what came, is seen in what follows.
        late[: -round(0.5 / interval)][rng.random(n - round(0.5 / interval)) < 3e-4] += 0.15
        return np.maximum.accumulate(time + late) + 1e-9 * np.arange(n)
    if kind.startswith("in bursts of"):
        size = int(kind.split()[-1])
        last = np.minimum(np.arange(n) // size * size + size - 1, n - 1)
        return time[last] + 1e-5 * (np.arange(n) % size)
    assert kind == "drifting"
    return time * (1 + 3e-5) + 2e-3 * np.sin(time / 30) + rng.normal(0, 3e-4, n)


@pytest.mark.parametrize("scatter", [0.0, 1e-3])
@pytest.mark.parametrize("rate", [10.0, 30.0])
def test_what_is_taken_up_anew_after_a_gap_is_not_moved_onto_the_old_grid(
    rate: float, scatter: float
) -> None:
    """What tracks a body begins when it sees it again, and not when the next sample was due."""
    rng = np.random.default_rng(6)
    parts = (np.arange(0.0, 60.0, 1 / rate), np.arange(60.453, 120.0, 1 / rate))
    true = np.concatenate(parts)
    values = np.stack([np.sin(0.9 * true), np.cos(1.3 * true)], axis=1)
    found = even_times(true + np.clip(rng.normal(0.0, scatter, len(true)), -0.01, 0.01), values)
    assert found is None or np.abs(found - true).max() < 1e-3


@pytest.mark.parametrize("kind", ["jitter", "rounded", "held up", *BURSTS, "drifting"])
@pytest.mark.parametrize("rate", [64.0, 104.0, 416.0])
def test_even_times_come_back(kind: str, rate: float) -> None:
    true = bench(rate)
    shown = replace(true, time=stamps(kind, true.time, np.random.default_rng(5)))
    found = evened(shown)
    assert found is not shown
    rates = np.diff(found.time) * rate
    # A turn of 180 degrees is then right to hundredths of a degree, whatever the clock does.
    assert np.abs(rates - 1.0).max() < 1.5e-4
    late = found.time - true.time
    assert np.ptp(late) < 1.5 * np.ptp(shown.time - true.time)
    # In turns the median distance from the stamps stays what a constant delay is.
    assert np.abs(np.median(found.time - shown.time)) < 0.5 / rate + 1e-3


def test_a_clock_that_keeps_its_pace_has_no_bends() -> None:
    true = bench(64.0, poses=40)
    normal, bends = [], []
    for seed in range(60):
        shown = stamps("jitter", true.time, np.random.default_rng((7, seed)))
        found = evened(replace(true, time=shown)).time
        pace, offset = np.polyfit(true.time - true.time.mean(), found - true.time, 1)
        errors = clock_errors(shown, found)
        normal.append(np.array([offset, pace]) / errors)
        line = offset + pace * (true.time - true.time.mean())
        bends.append(np.abs(found - true.time - line).max())
    # Of a chance of BENT there are one or two in 60.
    assert np.sum(np.array(bends) > 1e-8) <= 4
    # One standard error each: chi-squared of 60, between its quantiles of 1e-3.
    size = np.square(normal).sum(axis=0)
    assert (size > 32.0).all()
    assert (size < 99.6).all()


def test_a_clock_that_changes_its_pace_is_followed() -> None:
    true = bench(100.0, poses=60)
    wander = 2e-3 * np.sin(true.time / 60)
    rng = np.random.default_rng(8)
    shown = true.time + wander + np.clip(rng.normal(0, 5e-4, len(true)), -4e-3, 4e-3)
    left = evened(replace(true, time=shown)).time - true.time - wander
    assert np.std(left) < 0.05 * np.std(wander)


def test_samples_taken_unevenly_keep_their_times() -> None:
    rng = np.random.default_rng(6)
    time = np.arange(0, 60, 0.01)
    time = time + np.clip(rng.normal(0, 1.5e-3, len(time)), -4e-3, 4e-3) + 4e-3
    uneven = bench(time=time)
    assert evened(uneven) is uneven


def test_even_stamps_and_wrong_clocks_are_left_alone() -> None:
    even = bench()
    assert evened(even) is even
    shown = stamps("jitter", even.time, np.random.default_rng(7))
    wrong = replace(even, time=shown, clock="invalid")
    assert evened(wrong) is wrong
    assert evened(shown_few := replace(even, time=shown).slice(0, 40)) is shown_few


def test_a_pause_parts_two_clocks() -> None:
    true = bench()
    n = len(true) // 2
    time = stamps("jitter", true.time, np.random.default_rng(8))
    time[n:] += 3.1234
    found = evened(replace(true, time=time))
    step = np.diff(found.time)
    assert step[n - 1] == pytest.approx(3.1334, abs=2e-3)
    assert np.abs(np.delete(step, n - 1) - 0.01).max() < 1e-5


@given(st.lists(st.tuples(st.integers(90, 300), st.integers(1, 5)), max_size=8), st.integers(0, 99))
def test_lost_samples_are_counted_however_stamps_scatter(holes, seed) -> None:
    rng = np.random.default_rng(seed)
    missing = np.zeros(200 + sum(apart for apart, _ in holes), np.int64)
    at = 0
    for apart, lost in holes:
        at += apart
        missing[at] = lost
    number = np.arange(len(missing)) + np.cumsum(missing)
    time = 0.005 * (number + rng.uniform(-0.2, 0.2, len(number)))
    assert np.array_equal(sample_numbers(time), number)
    assert np.array_equal(sample_numbers(time, missing), number)


def test_rows_that_are_not_finite_do_not_count() -> None:
    true = bench()
    time = stamps("jitter", true.time, np.random.default_rng(9))
    values = true.gyro.copy()
    values[500:600] = np.nan
    found = even_times(time, values)
    assert found is not None
    assert np.abs(np.diff(found) - 0.01).max() < 1e-5
    assert even_times(time, np.full_like(values, np.nan)) is None


def test_what_is_fitted_is_what_even_stamps_give() -> None:
    true = bench(poses=16)
    shown = replace(true, time=stamps("jitter", true.time, np.random.default_rng(10)))
    one, other = (calibrate(r, gravity=GRAVITY) for r in (true, shown))
    for c, sigma in zip(one.names, np.sqrt(np.diag(one.covariance)), strict=True):
        assert abs(one.values[c] - other.values[c]) < 0.5 * sigma, c
    found = diagnose_recording(shown, gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert found.summary["stamps"].endswith("ms rms")


def turning(taken: FloatArray, stamps: FloatArray) -> Recording:
    """Return turns of two seconds, and rests as long between them, seen when they were taken."""
    rng = np.random.default_rng(4)
    part = np.clip(np.mod(taken, 4.0) / 2.0, 0, 1)
    rate = np.outer(np.sin(np.pi * part) ** 2, [1.5, -1.0, 0.5])
    turned = np.floor(taken / 4.0) + part - np.sin(2 * np.pi * part) / (2 * np.pi)
    tilt = turned[:, None]
    force = 9.8 * np.hstack((np.sin(tilt), np.cos(tilt), 0.1 * np.sin(tilt)))
    return Recording(
        stamps,
        force + 0.01 * rng.normal(size=force.shape),
        rate + 1e-3 * rng.normal(size=rate.shape),
        "device",
    )


def scatter(stamps: FloatArray, taken: FloatArray) -> float:
    return float(np.std(np.diff(stamps - taken)))


@pytest.mark.parametrize("epoch", [0.0, 1.7e9])
def test_scatter_that_signals_do_not_follow_goes(epoch: float) -> None:
    taken = np.arange(6000) / TURNING
    late = 1e-3 * np.random.default_rng(1).uniform(-1, 1, len(taken))
    stamps = epoch + taken + late
    mended = evened(turning(taken, stamps)).time - epoch
    assert scatter(mended, taken) < 0.1 * scatter(stamps - epoch, taken)


def test_scatter_that_signals_follow_stays() -> None:
    taken = np.arange(6000) / TURNING
    taken += 1e-3 * np.random.default_rng(1).uniform(-1, 1, len(taken))
    uneven = turning(taken, taken)
    assert evened(uneven) is uneven


def test_a_gap_and_the_rate_of_a_clock_stay() -> None:
    taken = np.delete(np.arange(6000) / TURNING, [700, 701, 702])
    late = 1e-3 * np.random.default_rng(2).uniform(-1, 1, len(taken))
    stamps = 1.001 * taken + late
    mended = evened(turning(taken, stamps)).time
    assert np.abs(mended - 1.001 * taken).max() < 1.1e-3
    assert scatter(
        np.delete(mended, slice(690, 710)), np.delete(1.001 * taken, slice(690, 710))
    ) < (0.2 * scatter(stamps, 1.001 * taken))


@pytest.mark.parametrize("size", [4, 16, 25])
@pytest.mark.parametrize("late", [3e-3, 8e-3])
def test_packets_that_are_late_together_are_of_one_clock(size: int, late: float) -> None:
    """A few packets that are later than those before are no new beginning, and none is lost."""
    true = bench(100.0, poses=16)
    rng = np.random.default_rng((11, size))
    number = np.arange(len(true))
    packet = number // size
    delay = late * np.abs(rng.normal(size=packet[-1] + 1))
    arrived = np.maximum.accumulate((np.arange(packet[-1] + 1) + 1) * size / 100.0 + delay)
    shown = Ticks().counted_on(arrived[packet])
    found = evened(replace(true, time=shown))
    assert np.abs(np.diff(found.time) * 100.0 - 1.0).max() < 5e-5


@pytest.mark.parametrize("lost", [1, 3, 50])
def test_what_stays_late_among_late_packets_is_lost(lost: int) -> None:
    rng = np.random.default_rng((12, lost))
    count, size = 20_000, 10
    number = np.arange(count) + lost * (np.arange(count) >= 9000)
    arrived = np.maximum.accumulate(
        number[size - 1 :: size] / 100.0 + rng.exponential(5e-3, count // size)
    )
    found = sample_numbers(Ticks().counted_on(np.repeat(arrived, size)))
    assert found[-1] == number[-1]
    assert abs(int(np.argmax(np.diff(found))) - 9000) <= 3 * size


@pytest.mark.parametrize("rate", [99.95, 416.0])
def test_delays_of_many_samples_are_no_losses(rate: float) -> None:
    rng = np.random.default_rng(13)
    taken = np.arange(20_000) / rate
    late = np.maximum.accumulate(taken + rng.exponential(5e-3, len(taken)))
    found = sample_numbers(late + 1e-9 * np.arange(len(taken)))
    assert found[-1] == len(taken) - 1
