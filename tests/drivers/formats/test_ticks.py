"""Stamps that several samples share are counted on from, in batches as in one piece."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import InvalidSampleError
from calib.rounded_stamps import ROUNDED
from calib.timing import SHARED
from drivers.formats import open_batches, read_recording
from drivers.formats.ticks import Ticks


def ticked(time: np.ndarray, tick: float) -> np.ndarray:
    return np.floor(time / tick + 1e-9) * tick


@given(
    rate=st.floats(20.0, 2000.0),
    shared=st.floats(1.5, 40.0),
    phase=st.floats(0.0, 1.0),
    batch=st.sampled_from([500, 1777, 10_000]),
)
def test_times_are_within_a_sample_of_the_truth_and_increase(
    rate: float, shared: float, phase: float, batch: int
) -> None:
    time = (np.arange(4000) + phase) / rate
    stamps = ticked(time, shared / rate)
    ticks = Ticks()
    parts = [ticks.counted_on(stamps[k : k + batch]) for k in range(0, len(stamps), batch)]
    found = np.concatenate(parts)
    assert np.diff(found).min() > 0
    # The first batch may know the pace roughly only, and a group ends with its tick.
    assert np.ptp(found - time) * rate < 2.0
    assert ticks.interval * rate == pytest.approx(1.0, abs=0.05)
    assert ticks.tick * rate == pytest.approx(shared, abs=1.0)


def test_stamps_of_their_own_stay_as_they_are() -> None:
    time = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 1000)) / 100
    mistaken = np.insert(time, 500, time[500])
    ticks = Ticks()
    assert np.array_equal(ticks.counted_on(mistaken), mistaken)
    assert ticks.interval == 0


def test_rows_that_go_back_or_have_no_time_are_left_to_others() -> None:
    stamps = ticked(np.arange(2000) / 200, 0.01)
    stamps[700], stamps[900] = stamps[700] - 3.0, np.nan
    found = Ticks().counted_on(stamps)
    assert found[700] == stamps[700]
    assert np.isnan(found[900])
    rest = np.delete(found, [700, 900])
    assert np.diff(rest).min() > 0


def test_a_clock_that_stands_still_tells_no_time() -> None:
    stamps = np.full(1000, 12.0)
    assert np.array_equal(Ticks().counted_on(stamps), stamps)


def written(path: Path, stamps: np.ndarray) -> Path:
    values = np.random.default_rng(2).normal(size=(len(stamps), 6))
    names = "time,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    np.savetxt(path, np.c_[stamps, values], delimiter=",", header=names, comments="")
    return path


def test_a_log_of_hundredths_is_read_and_says_so(tmp_path: Path) -> None:
    time = np.arange(3000) / 250
    log = written(tmp_path / "log.csv", ticked(time, 0.01))
    recording = read_recording(log)
    assert recording.notes[ROUNDED].startswith("to 0.01 s: samples are taken as even, at 250.00 Hz")
    assert len(recording) == 3000
    np.testing.assert_allclose(recording.time, time, atol=0.011)
    batches = list(open_batches(log, batch=700))
    assert sum(map(len, batches)) == 3000


def test_a_log_of_late_packets_is_counted_on_and_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    arrived = 0.16 * np.arange(1, 201) + rng.exponential(8e-3, 200)
    recording = read_recording(written(tmp_path / "log.csv", np.repeat(arrived, 16)))
    assert recording.notes[SHARED].endswith("apart, counted on between")
    assert len(recording) == 3200


def test_a_log_with_one_stamp_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSampleError, match="time does not increase"):
        read_recording(written(tmp_path / "log.csv", np.full(300, 5.0)))


@pytest.mark.parametrize("batch", [37, 10_000])
def test_stamps_that_rounding_made_alike_are_told_apart(tmp_path: Path, batch: int) -> None:
    """Whole milliseconds of a late host: 30 of 13000 rows had the stamp of the one before."""
    rng = np.random.default_rng(7)
    time = 12.0 + np.arange(4000) / 200
    stamps = np.round(np.maximum.accumulate(time + rng.exponential(1.2e-3, len(time))), 3)
    assert 10 < (np.diff(stamps) == 0).sum() < 200
    log = written(tmp_path / "log.csv", stamps)
    parts = list(open_batches(log, batch=batch))
    read = np.concatenate([part.time for part in parts])
    assert (np.diff(read) > 0).all()
    assert len(read) == 4000
    assert np.abs(read - stamps).max() < 1e-3


def test_a_row_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    stamps = np.round(np.arange(300) / 125, 3)
    log = written(tmp_path / "log.csv", stamps)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join([*lines[:50], lines[49], *lines[50:]]))
    with pytest.raises(InvalidSampleError, match="line 51: time does not increase"):
        read_recording(log)
