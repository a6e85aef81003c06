"""Coarse stamps are explained by one even clock, and what is missing is still missing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.rounded_stamps import FEWEST, even_grid
from calib.types import FloatArray, IntArray

TICKS = [0.01, 1 / 64, 0.1, 1.0]
TENTHS = 0.1


def rounded(time: FloatArray, tick: float, kind: str = "cut off") -> FloatArray:
    half = 0.5 if kind == "rounded" else 1e-9
    return np.round(np.floor(time / tick + half) * tick, 6)


def bends(found: FloatArray, taken: FloatArray) -> float:
    """Return how far the line from the truth leaves a straight one, and its pace, s per s."""
    return float(np.abs(np.diff(found - taken)).max() / np.median(np.diff(taken)))


@given(
    rate=st.floats(20.0, 1000.0),
    tick=st.sampled_from(TICKS),
    kind=st.sampled_from(["cut off", "rounded"]),
    begun=st.floats(0.0, 5.0),
)
@settings(max_examples=60, deadline=None)
def test_even_samples_come_back_from_coarse_stamps(
    rate: float, tick: float, kind: str, begun: float
) -> None:
    taken = begun + np.arange(20_000) / rate
    stamps = rounded(taken, tick, kind)
    found = even_grid(stamps)
    if found is None:
        # Finer than what beats, or steps that exact stamps would have, too.
        steps = np.unique(np.rint(np.diff(stamps) / tick))
        assert tick * rate < 0.16 or len(steps) <= 2
        return
    assert found.number[-1] - found.number[0] == len(taken) - 1
    assert bends(found.time, taken) < 3 * max(tick, 1 / rate) / np.ptp(taken)
    assert np.abs(found.time - stamps).max() < tick
    assert found.interval * rate == pytest.approx(1.0, abs=1e-3)


@given(
    rate=st.floats(95.0, 105.0),
    tick=st.sampled_from([0.01, 1 / 64, TENTHS]),
    lost=st.lists(st.integers(2, 60), min_size=1, max_size=3),
    seed=st.integers(0, 99),
)
@settings(max_examples=60, deadline=None)
def test_what_is_missing_is_counted_to_one_sample(
    rate: float, tick: float, lost: list[int], seed: int
) -> None:
    """Where stamps are those of several samples, one of them may hide in what ticks leave open."""
    rng = np.random.default_rng(seed)
    places = 4000 * np.arange(1, len(lost) + 1) + rng.integers(0, 1000, len(lost))
    taken, number = with_losses(rate, 20_000, places, np.array(lost))
    found = even_grid(rounded(taken, tick))
    if found is None:
        assert np.abs(tick * rate - 1.0) < 3e-4  # exact stamps would look so
        return
    gone = np.diff(found.number) - 1
    assert np.count_nonzero(gone) == len(lost)
    assert np.abs(gone[gone > 0] - lost).max() <= 1
    assert np.abs(np.flatnonzero(gone) - places).max() < 3 * max(1.0, tick * rate) + 2000 * (
        np.abs(tick * rate - np.rint(tick * rate)) < 0.01
    )
    assert number[-1] - number[0] - (found.number[-1] - found.number[0]) <= len(lost)


def with_losses(
    rate: float, count: int, places: IntArray, lost: IntArray
) -> tuple[FloatArray, IntArray]:
    number = np.arange(count)
    number = number + np.sum(
        [m * (number > at) for at, m in zip(places, lost, strict=True)], axis=0
    )
    return number / rate, number


def test_one_sample_is_found_where_ticks_leave_nothing_open() -> None:
    taken, number = with_losses(99.7, 20_000, np.array([7000]), np.array([1]))
    found = even_grid(rounded(taken, TENTHS))
    assert found is not None
    assert found.number[-1] == number[-1]
    assert found.hidden == 0


def test_what_could_hide_is_said() -> None:
    taken = np.arange(20_000) / 100
    found = even_grid(rounded(taken, TENTHS))
    assert found is not None
    assert found.hidden == 1
    assert found.said == (
        "to 0.1 s: samples are taken as even, at 100.00 Hz; a lost sample could hide in that"
    )


@pytest.mark.parametrize("wander", [5e-6, 2e-5])
def test_a_clock_that_warms_is_followed(wander: float) -> None:
    at = np.arange(40_000) / 104
    taken = at + np.cumsum(wander * np.sin(at / 60)) / 104
    found = even_grid(rounded(taken, TENTHS))
    assert found is not None
    assert found.number[-1] == len(taken) - 1
    assert bends(found.time, taken) < 5e-5


@pytest.mark.parametrize("late", [2e-4, 1e-3])
def test_stamps_that_are_late_and_then_rounded_are_even_still(late: float) -> None:
    rng = np.random.default_rng(3)
    taken = np.arange(20_000) / 99.95
    found = even_grid(rounded(taken + rng.uniform(0.0, late, len(taken)), 0.01))
    assert found is not None
    assert found.number[-1] == len(taken) - 1
    assert bends(found.time, taken) < 5e-5


def test_samples_that_are_known_to_be_lost_count() -> None:
    taken, number = with_losses(99.7, 20_000, np.array([7000, 9000]), np.array([3, 40]))
    lost = np.diff(number, prepend=-1) - 1
    found = even_grid(rounded(taken, TENTHS), lost)
    assert found is not None
    np.testing.assert_array_equal(found.number, number)


def test_exact_stamps_with_holes_stay_as_they_are() -> None:
    """Three samples that are missing are no clock that is slow, unless they lie on a line."""
    taken, _ = with_losses(100.0, 20_000, np.array([3000, 3500, 15_000, 15_100]), np.ones(4, int))
    assert even_grid(np.round(taken, 6)) is None


def test_an_epoch_changes_nothing() -> None:
    taken = np.arange(20_000) / 99.7
    near, far = even_grid(rounded(taken, TENTHS)), even_grid(1.7e9 + rounded(taken, TENTHS))
    assert near is not None
    assert far is not None
    assert np.abs(far.time - 1.7e9 - near.time).max() < 1e-5


@pytest.mark.parametrize("kind", ["fine", "uneven", "standing", "few"])
def test_other_stamps_are_not_evened(kind: str) -> None:
    rng = np.random.default_rng(4)
    even = np.arange(5000) / 99.7
    stamps = {
        "fine": np.round(even, 3),
        "uneven": rounded(np.cumsum(rng.exponential(0.01, 5000)), 0.01),
        "standing": np.full(5000, 3.0),
        "few": rounded(even[: FEWEST - 1], TENTHS),
    }
    assert even_grid(stamps[kind]) is None


def test_milliseconds_of_a_clock_that_warms_are_even() -> None:
    at = np.arange(60_000) / 833
    taken = at + np.cumsum(1e-5 * np.sin(at / 50)) / 833
    found = even_grid(rounded(taken, 1e-3))
    assert found is not None
    assert found.number[-1] == len(taken) - 1
    assert bends(found.time, taken) < 5e-5


@pytest.mark.parametrize("pause", [3.456, 250.0])
def test_a_pause_of_any_length_parts_no_clock(pause: float) -> None:
    taken = np.arange(20_000) / 99.7
    taken[9000:] += pause
    found = even_grid(rounded(taken, 0.01))
    assert found is not None
    step = np.diff(found.time)
    assert step[8999] == pytest.approx(pause + 1 / 99.7, abs=2e-3)
    assert np.abs(np.delete(step, 8999) * 99.7 - 1.0).max() < 5e-5
