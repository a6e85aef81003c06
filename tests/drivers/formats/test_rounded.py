"""Coarse stamps are evened as a log is read, in batches as in one piece."""

from pathlib import Path

import numpy as np
import pytest

from calib import faults
from calib.errors import InvalidSampleError
from calib.rounded_stamps import ROUNDED
from calib.types import FloatArray
from drivers.formats import open_batches, read_recording
from drivers.formats.rounded import Rounded


def written(path: Path, stamps: FloatArray) -> Path:
    values = np.random.default_rng(2).normal(size=(len(stamps), 6))
    names = "time,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    np.savetxt(path, np.c_[stamps, values], delimiter=",", header=names, comments="")
    return path


@pytest.mark.parametrize("batch", [700, 4096, None])
@pytest.mark.parametrize(("rate", "digits"), [(100.0, 1), (99.7, 1), (99.95, 2), (104.0, 2)])
def test_a_log_of_few_digits_is_read_as_it_was_sampled(
    tmp_path: Path, rate: float, digits: int, batch: int | None
) -> None:
    taken = np.arange(20_000) / rate
    log = written(tmp_path / "log.csv", np.round(taken, digits))
    parts = [read_recording(log)] if batch is None else list(open_batches(log, batch=batch))
    time = np.concatenate([part.time for part in parts])
    assert len(time) == len(taken)
    assert np.diff(time).min() > 0
    # The first batches know the pace roughly.
    late = (time - taken)[len(time) // 2 :]
    assert np.ptp(late) * rate < (1e-3 if batch is None else 0.3)
    assert parts[-1].notes[ROUNDED].startswith(f"to {10.0**-digits:g} s: samples are taken as even")
    if batch is None:
        assert not faults.find_gaps(parts[0]).at.size


def test_rows_that_are_not_finite_or_go_back_are_left_to_others() -> None:
    stamps = np.round(np.arange(5000) / 99.7, 1)
    stamps[700], stamps[900] = stamps[700] - 3.0, np.nan
    found = Rounded().evened(stamps, None)
    assert found is not None
    assert found[700] == stamps[700]
    assert np.isnan(found[900])
    rest = np.delete(found, [700, 900])
    assert np.abs(np.diff(rest) * 99.7 - 1).max() == pytest.approx(1.0, abs=1e-3)


def test_a_gap_that_is_known_stays(tmp_path: Path) -> None:
    number = np.delete(np.arange(20_000), np.s_[9000:9050])
    recording = read_recording(written(tmp_path / "log.csv", np.round(number / 99.7, 1)))
    gaps = faults.find_gaps(recording)
    assert gaps.missing.tolist() == [50]
    assert abs(int(gaps.at[0]) - 9000) <= 10


def test_a_clock_that_starts_again_is_refused(tmp_path: Path) -> None:
    stamps = np.round(np.arange(5000) / 99.7, 1)
    with pytest.raises(InvalidSampleError, match="time does not increase"):
        read_recording(written(tmp_path / "log.csv", np.r_[stamps, stamps]))


def test_stamps_that_become_coarse_no_more_go_on(tmp_path: Path) -> None:
    coarse = np.round(np.arange(5000) / 99.7, 1)
    coarse = coarse[coarse < 50.0]
    fine = coarse[-1] + np.cumsum(np.random.default_rng(1).uniform(1e-3, 0.02, 5000))
    log = written(tmp_path / "log.csv", np.r_[coarse, fine])
    time = np.concatenate([part.time for part in open_batches(log, batch=len(coarse))])
    assert len(time) == len(coarse) + 5000
    assert np.diff(time).min() > 0
