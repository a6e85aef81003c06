from collections import Counter

import numpy as np
import pytest

from calib.errors import UnitError
from drivers.clock import SteadyClock, Timeline
from drivers.dialects.base import Samples


def samples(count: int, ticks: np.ndarray | None = None, lost: int = 0) -> Samples:
    missing = np.zeros(count, np.int64)
    missing[:1] = lost
    return Samples(np.zeros((count, 3)), np.zeros((count, 3)), missing, ticks=ticks)


def run(
    timeline: Timeline, parts: list[tuple[Samples, float | None]]
) -> tuple[np.ndarray, np.ndarray]:
    times, lost = [], []
    for k, (part, arrival) in enumerate(parts):
        timeline.add(part, arrival)
        while (placed := timeline.take(final=k == len(parts) - 1)) is not None:
            times.append(placed[0])
            lost.append(placed[1].lost)
    return np.concatenate(times), np.concatenate(lost)


def timeline(period: float | None = None, rate: float | None = None) -> Timeline:
    return Timeline(period=period, rate=rate, counters=Counter())


def test_arrivals_become_steady() -> None:
    """Delays of 0 to 15 ms, some of 80 ms: the interval to 1e-4, no sample off by over 2 ms."""
    generator = np.random.default_rng(1)
    rate, taken = 199.3, 0
    parts = []
    for k in range(1000):
        due = int((k + 1) * 0.02 * rate)
        delay = generator.exponential(0.004) + 0.08 * (generator.random() < 0.01)
        parts.append((samples(due - taken), due / rate + delay))
        taken = due
    line = timeline()
    times, lost = run(line, parts)
    assert line.clock == "host"
    assert lost.sum() == 0
    assert len(times) == taken
    assert np.diff(times).min() > 0
    late = times[400:] - np.arange(len(times))[400:] / rate
    assert np.ptp(late) < 0.002
    assert 1 / line.interval == pytest.approx(rate, rel=1e-4)


def test_a_silent_gap_is_marked_and_a_stall_is_not() -> None:
    rate = 100.0
    parts = [(samples(10), (k + 1) * 0.1) for k in range(40)]
    # The reader was held up for 0.6 s, and then got everything at once: nothing is missing.
    parts += [(samples(60), 4.6)] + [(samples(10), 4.7 + k * 0.1) for k in range(20)]
    # The device was silent for 2 s.
    parts += [(samples(10), 8.6 + k * 0.1) for k in range(1, 20)]
    times, lost = run(timeline(), parts)
    assert np.count_nonzero(lost) == 1
    assert lost.sum() == pytest.approx(2.0 * rate, abs=2)
    assert np.diff(times).max() == pytest.approx(2.0, abs=0.05)


def test_known_losses_move_the_index() -> None:
    parts = [(samples(10), (k + 1) * 0.1) for k in range(30)]
    parts += [(samples(5, lost=5), 3.1)] + [(samples(10), 3.2 + 0.1 * k) for k in range(10)]
    times, lost = run(timeline(), parts)
    assert lost.sum() == 5
    assert np.diff(times).max() == pytest.approx(0.06, abs=0.002)


@pytest.mark.parametrize("count", [1, 5])
def test_a_stream_too_short_for_a_line(count: int) -> None:
    times, _ = run(timeline(), [(samples(count), 3.0)])
    assert len(times) == count
    assert times[0] == 0.0


def test_the_hulls_edge_over_the_middle() -> None:
    clock = SteadyClock()
    for index, arrival in ((0, 0.0), (10, 1.3), (20, 2.0), (30, 3.4), (40, 4.0)):
        clock.remember(index, arrival)
    assert clock.interval == pytest.approx(0.1)
    assert clock.origin == pytest.approx(0.0)


def test_device_clock_wraps_and_shows_what_is_missing() -> None:
    period = 2**32 * 1e-6
    true = np.arange(200) * 0.005
    ticks = (period - 0.3 + true) % period
    keep = np.ones(200, bool)
    keep[120:123] = False
    parts = [
        (samples(int(k.sum()), t[k]), None)
        for t, k in zip(np.split(ticks, 8), np.split(keep, 8), strict=True)
    ]
    line = timeline(period)
    times, lost = run(line, parts)
    assert line.clock == "device"
    assert np.allclose(times, true[keep], atol=1e-9)
    assert lost.sum() == 3
    assert lost[120] == 3


def test_device_that_restarts_goes_on_after_the_hosts_gap() -> None:
    first = [(samples(20, 5 + np.arange(20) * 0.01 + 0.2 * k), 0.2 * k) for k in range(5)]
    again = [(samples(20, np.arange(20) * 0.01 + 0.2 * k), 3.0 + 0.2 * k) for k in range(5)]
    line = timeline(1e6)
    times, lost = run(line, first + again)
    assert np.diff(times).min() > 0
    assert line._counters["clock_restarts"] == 1
    assert np.diff(times).max() == pytest.approx(2.0, abs=0.02)
    assert lost[100] > 150


def test_repeated_stamps_are_dropped_and_counted() -> None:
    ticks = np.arange(100) * 0.01
    ticks[50] = ticks[49]
    line = timeline()
    times, _ = run(line, [(samples(100, ticks), None)])
    assert len(times) == 99
    assert line._counters == {"repeated_samples": 1}


def test_a_coarse_device_clock_is_made_steady() -> None:
    """millis() at 4 kHz: four samples share a stamp, and every sample is kept."""
    true = np.arange(12_000) / 4000
    ticks = np.floor(true * 1e3) * 1e-3
    parts = [(samples(100, t), None) for t in np.split(ticks, 120)]
    line = timeline()
    times, lost = run(line, parts)
    assert line.clock == "device"
    assert len(times) == 12_000
    assert lost.sum() == 0
    assert np.ptp(times - true) < 1.1e-3
    assert line.interval == pytest.approx(1 / 4000, rel=1e-3)


def test_without_any_time_the_rate_must_be_said() -> None:
    with pytest.raises(UnitError, match="rate="):
        timeline().add(samples(3), None)
    line = timeline(rate=50.0)
    times, _ = run(line, [(samples(3), None), (samples(2, lost=1), None)])
    assert line.clock == "nominal"
    assert np.allclose(times, [0, 0.02, 0.04, 0.08, 0.1])
