"""Reference files: a table's profile as angles or as rates."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import RecordingFormatError
from calib.mismatch import ReferenceMotion
from calib.simulation.turntable import turntable
from drivers.reference_file import read_reference, refuse_reference


def written(path: Path, name: str, time: np.ndarray, values: np.ndarray) -> Path:
    lines = [f"{t:.6f},{v:.9f}" for t, v in zip(time, values, strict=True)]
    path.write_text("\n".join([f"time,{name}", *lines]) + "\n")
    return path


@pytest.mark.parametrize("rate", [10.0, 20.0, 50.0])
def test_a_profile_of_rates_turns_as_one_of_angles(tmp_path: Path, rate: float) -> None:
    table = turntable([1.0, -2.0, 3.5, -5.0])
    time = np.arange(0.0, table.duration, 1.0 / rate)
    turning = table.kinematics(time)[0]
    path = written(tmp_path / "rate.csv", "rate_dps", time, np.degrees(turning.rate[:, 2]))
    found = read_reference(path)
    assert isinstance(found, ReferenceMotion)
    truth = found.truth(gravity=9.8)
    known = truth.recording.time
    expected = table.kinematics(known)[0].rate[:, 2]
    # Half of the noise of one sample of a consumer part; straight lines leave 4e-3.
    assert np.abs(truth.recording.gyro[:, 2] - expected).max() < 2e-4


@pytest.mark.parametrize("name", ["angle", "angle_deg", "rate", "rate_dps"])
@pytest.mark.parametrize(("top", "rate"), [(200.0, 1.0), (-550.0, 2.0), (1500.0, 5.0)])
def test_a_table_may_turn_by_more_than_half_a_turn_from_row_to_row(
    tmp_path: Path, name: str, top: float, rate: float
) -> None:
    """200 deg/s in rows of a second were -160 deg/s."""
    table = turntable([np.radians(top)], spin=40.0, ramp=8.0 / rate, rest=6.0 / rate)
    fine = np.arange(0.0, table.duration, 1e-3)
    turned = np.concatenate(([0.0], np.cumsum(table.kinematics(fine)[0].rate[:, 2])))[:-1] * 1e-3
    time = np.arange(0.0, table.duration, 1.0 / rate)
    values = np.interp(time, fine, turned)
    if name.startswith("rate"):
        values = table.kinematics(time)[0].rate[:, 2]
    if name.endswith(("deg", "dps")):
        values = np.degrees(values)
    found = read_reference(written(tmp_path / "table.csv", name, time, values))
    assert isinstance(found, ReferenceMotion)
    state = found.truth(gravity=9.8).recording
    steady = (state.time > 20.0) & (state.time < 40.0)
    np.testing.assert_allclose(np.degrees(state.gyro[steady, 2]), top, rtol=2e-3)


def test_gaps_of_a_fast_table_stay(tmp_path: Path) -> None:
    time = np.arange(60.0)
    angle = 200.0 * time
    angle[20:24] = np.nan
    found = read_reference(written(tmp_path / "table.csv", "angle_deg", time, angle))
    assert isinstance(found, ReferenceMotion)
    hidden = found.time[~found.known]
    assert 19.0 < hidden.min() < 19.2
    assert 23.8 < hidden.max() < 24.0
    assert len(hidden) > 20


def test_angles_within_one_turn_may_be_wrapped(tmp_path: Path) -> None:
    time = np.arange(0.0, 20.0, 0.05)
    angle = 90.0 * time
    for name, wrapped in (("a.csv", angle % 360), ("b.csv", (angle + 180) % 360 - 180)):
        found = read_reference(written(tmp_path / name, "angle_deg", time, wrapped))
        assert isinstance(found, ReferenceMotion)
        assert len(found.time) == len(time)
        gyro = found.truth(gravity=9.8).recording.gyro
        np.testing.assert_allclose(np.degrees(gyro[:, 2]), 90.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("jump", "known", "said"),
    [
        (1e9, 40, r"turns by 1e\+09 degrees in a row to 7 s"),
        (0.0, 3, "in 3 rows, expected at least 4"),
    ],
)
def test_profiles_that_cannot_be_are_refused(
    tmp_path: Path, jump: float, known: int, said: str
) -> None:
    time, angle = np.arange(40.0), np.zeros(40)
    angle[7:] = jump
    angle[known:] = np.nan
    path = written(tmp_path / "table.csv", "angle_deg", time, angle)
    with pytest.raises(RecordingFormatError, match=said):
        read_reference(path)


def test_a_profile_of_rates_has_no_gap(tmp_path: Path) -> None:
    path = tmp_path / "gap.csv"
    path.write_text("time,rate\n0,0\n0.1,1\n0.2,\n0.3,1\n0.4,0\n")
    with pytest.raises(RecordingFormatError, match=r"missing at 0.2 s.*give the angle"):
        read_reference(path)


def test_a_profile_of_few_rates_is_integrated_too(tmp_path: Path) -> None:
    time = 0.1 * np.arange(5)
    found = read_reference(written(tmp_path / "few.csv", "rate", time, np.full(5, 0.5)))
    assert isinstance(found, ReferenceMotion)
    assert 2 * np.arctan2(found.quat[-1, 3], found.quat[-1, 0]) == pytest.approx(0.2)


def test_quaternions_of_zeros_are_gaps(tmp_path: Path) -> None:
    rows = [f"{0.01 * k:.2f},0.6,0,0.8,0" for k in range(40)]
    rows[10:20] = [f"{0.01 * k:.2f},0,0,0,0" for k in range(10, 20)]
    path = tmp_path / "captured.csv"
    path.write_text("\n".join(["time,qw,qx,qy,qz", *rows]) + "\n")
    found = read_reference(path)
    assert isinstance(found, ReferenceMotion)
    assert np.flatnonzero(~found.known).tolist() == list(range(10, 20))
    assert np.isnan(found.quat[10:20]).all()
    path.write_text("\n".join(["time,qw,qx,qy,qz", *rows[10:20]]) + "\n")
    with pytest.raises(RecordingFormatError, match="quaternions are none, expected 1"):
        read_reference(path)


@pytest.mark.parametrize("name", ["angle_deg", "qw,qx,qy,qz", "qw,qx,qy,qz,x,y,z"])
def test_what_moved_is_no_recording_of_what_was_felt(tmp_path: Path, name: str) -> None:
    path = tmp_path / "moved.csv"
    rows = [f"{0.1 * k},1" + ",0" * name.count(",") for k in range(8)]
    path.write_text("\n".join([f"time,{name}", *rows]) + "\n")
    with pytest.raises(RecordingFormatError, match=r"how a body moved.*--reference moved\.csv"):
        refuse_reference(path)
    path.write_text(path.read_text().replace(name, f"{name},ax", 1))
    refuse_reference(path)
    refuse_reference(tmp_path / "missing.csv")
