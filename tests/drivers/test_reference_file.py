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
