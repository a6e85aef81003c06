"""Calibrations on disk: whole or not at all, and clear words for what cannot be read."""

import json
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from calib.calibration import Calibration, Gravity, Provenance
from calib.document import to_document
from calib.errors import CalibrationFileError
from calib.model import SensorModel, Triad
from drivers.calibration_file import check_can_write, load_calibration, save_calibration


def example(note: str = "") -> Calibration:
    return Calibration(
        SensorModel(Triad(np.array([0.1, 0.2, 0.3]))),
        ("accel.bias.x", "accel.bias.y"),
        np.diag([1e-6, 2e-6]),
        ("gyro.bias.x",),
        Gravity(9.81),
        provenance=Provenance(notes={"remark": note}),
    )


def test_round_trip_through_a_file(tmp_path: Path) -> None:
    calibration = example('[\n 1,\n 2\n] "quoted" [ 1, 2 ] µ')
    save_calibration(calibration, tmp_path / "a.cal.json")
    again = load_calibration(tmp_path / "a.cal.json")
    assert to_document(again) == to_document(calibration)
    assert os.listdir(tmp_path) == ["a.cal.json"]


def test_rows_of_numbers_stand_on_one_line(tmp_path: Path) -> None:
    save_calibration(example(), tmp_path / "a.cal.json")
    text = (tmp_path / "a.cal.json").read_text(encoding="utf-8")
    assert "[1e-06, 0.0]" in text
    assert text.endswith("}\n")


@pytest.mark.skipif(os.name != "posix", reason="permission bits and links are POSIX")
def test_permissions_and_links_are_kept(tmp_path: Path) -> None:
    target = tmp_path / "real.json"
    target.write_text("old", encoding="utf-8")
    target.chmod(0o640)
    (tmp_path / "link.json").symlink_to(target)
    save_calibration(example(), tmp_path / "link.json")
    assert (tmp_path / "link.json").is_symlink()
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert load_calibration(target).gravity.value == 9.81


def test_a_failed_write_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.cal.json"
    save_calibration(example("first"), path)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CalibrationFileError, match="No space left"):
        save_calibration(example("second"), path)
    monkeypatch.undo()
    assert load_calibration(path).provenance.notes == {"remark": "first"}
    assert os.listdir(tmp_path) == ["a.cal.json"]


def test_every_cut_of_a_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.cal.json"
    save_calibration(example(), path)
    whole = path.read_bytes()
    for stop in range(0, len(whole.rstrip()), 97):
        path.write_bytes(whole[:stop])
        with pytest.raises(CalibrationFileError, match=r"a\.cal\.json"):
            load_calibration(path)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CalibrationFileError, match="is cut"):
        load_calibration(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\xff\xfe\x00binary", "not text"),
        (b"time,accel_x\n0,1\n", "not JSON"),
        (b"[" * 100_000, "lists within lists"),
        (b"[1, 2]", "must be an object"),
        (json.dumps({"format": "other"}).encode(), "expected 'imu-cal/calibration'"),
        (b'{"format": NaN}', "NaN"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(CalibrationFileError) as caught:
        load_calibration(path)
    assert message in str(caught.value)
    assert "x.json" in str(caught.value)


def test_missing_file_folder_and_place_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(CalibrationFileError, match="cannot read it"):
            load_calibration(path)
    with pytest.raises(CalibrationFileError, match="cannot write it"):
        save_calibration(example(), tmp_path / "no" / "a.json")


def test_where_nothing_can_be_written_is_known_before(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    for path in (tmp_path / "no" / "a.json", tmp_path / "file" / "a.json", tmp_path):
        with pytest.raises(CalibrationFileError, match="cannot write it"):
            check_can_write(path)
    check_can_write(tmp_path / "a.json")
    check_can_write(tmp_path / "file")
    assert os.listdir(tmp_path) == ["file"]
