"""Every bad input gets its own error and message: what was seen, expected, and what to do."""

from pathlib import Path

import pytest

from calib.errors import (
    EmptyRecordingError,
    InvalidSampleError,
    RecordingError,
    RecordingFormatError,
    RecordingNotFoundError,
)
from drivers.formats import open_batches, read_recording

BAD = Path(__file__).resolve().parents[3] / "fixtures" / "bad"

CASES = {
    "empty.csv": (EmptyRecordingError, "0 bytes"),
    "header_only.csv": (EmptyRecordingError, "a header but no samples"),
    "letter.csv": (RecordingFormatError, "text but no log"),
    "letter.txt": (RecordingFormatError, "text but no log"),
    "missing_column.csv": (RecordingFormatError, "no column gyro_z"),
    "ragged.csv": (RecordingFormatError, "line 112: 3 columns, expected 8"),
    "word.csv": (RecordingFormatError, "line 132: accel_z is 'error', expected a number"),
    "nan_row.csv": (InvalidSampleError, "line 69: gyro.y is nan.*--drop-invalid"),
    "infinite_row.csv": (InvalidSampleError, "line 152: accel.y is inf.*--drop-invalid"),
    "time_repeated.csv": (InvalidSampleError, "line 92: time does not increase"),
    "time_backwards.csv": (InvalidSampleError, "line 162: time does not increase.*split the file"),
    "no_names.log": (RecordingFormatError, "6 columns.*--profile mpu9150"),
    "binary.csv": (RecordingFormatError, "binary data"),
    "folder.csv": (RecordingNotFoundError, "is a folder"),
    "not_there.csv": (RecordingNotFoundError, "there is no file"),
    "word.cvs": (RecordingNotFoundError, r"did you mean .*word\.csv"),
}


@pytest.mark.parametrize("name", CASES)
def test_refused_with_a_message_of_its_own(name: str) -> None:
    kind, message = CASES[name]
    for read in (read_recording, lambda path: list(open_batches(path, batch=50))):
        with pytest.raises(RecordingError, match=message) as caught:
            read(BAD / name)
        assert type(caught.value) is kind
        assert str(BAD) in str(caught.value)
        assert caught.value.exit_code == 3


HEADER = "time (s);acc x (m/s^2);acc y (m/s^2);acc z (m/s^2);gyr x (dps);gyr y (dps);gyr z (dps)\n"
ROWS = "0,00;0,1;0,2;9,8;0,1;0,1;0,2\n0,01;0,1;0,2;9,8;0,1;0,1;0,2\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv.gz", b"\x1f\x8b\x08\x08\x1f\xca", "compressed by gzip: gunzip it first"),
        ("a.csv", b"\x1f\x8b\x08\x08\x1f\xca", "compressed by gzip: gunzip it first"),
        ("a.xlsx", b"PK\x03\x04\x14\x00", "export it as CSV"),
        ("a.csv", ROWS.encode(), "its numbers have decimal commas, between columns separated by"),
        ("a.csv", f"t;ax;ay;az;gx;gy;gz\n{ROWS}".encode(), "decimal commas.*decimal = "),
        ("a.csv", (HEADER + ROWS).encode(), "'0,[01]+', expected a number with a decimal point"),
    ],
)
def test_what_is_wrapped_or_written_otherwise_is_called_that(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingFormatError, match=message):
        read_recording(tmp_path / name)


def test_one_bad_row_is_one_row() -> None:
    with pytest.raises(InvalidSampleError, match=r"\(1 such row\)"):
        read_recording(BAD / "nan_row.csv")


@pytest.mark.parametrize("value", ["nan", "inf", "-39", "4 g"])
def test_a_full_scale_is_a_number(tmp_path: Path, value: str) -> None:
    path = tmp_path / "a.csv"
    text = (BAD / "one_pose.csv").read_text(encoding="utf-8")
    path.write_text(text.replace("39.2266", value), encoding="utf-8")
    with pytest.raises(RecordingFormatError, match=f"accel_full_scale is '{value}', expected"):
        read_recording(path)


@pytest.mark.parametrize("name", ["nan_row.csv", "infinite_row.csv", "time_repeated.csv"])
def test_drop_invalid_makes_a_gap(name: str) -> None:
    recording = read_recording(BAD / name, drop_invalid=True)
    assert (len(recording), recording.samples_lost) == (299, 1)
    assert recording.notes["dropped_rows"] == "1"


def test_drop_invalid_does_not_hide_a_clock_that_started_again() -> None:
    with pytest.raises(InvalidSampleError, match=r"went back by 14\.9 s"):
        read_recording(BAD / "time_backwards.csv", drop_invalid=True)


@pytest.mark.parametrize(("name", "count"), [("cut_line.csv", 299), ("killed.arrow", 250)])
def test_what_was_cut_reads_to_its_last_whole_part(name: str, count: int) -> None:
    recording = read_recording(BAD / name)
    assert len(recording) == count
    assert not recording.complete
    assert "cut" in recording.notes


def test_a_thermometer_that_says_nothing_is_none(tmp_path: Path) -> None:
    head = ",".join(f"{n} (m/s^2)" for n in ("acc x", "acc y", "acc z"))
    head += "," + ",".join(f"{n} (rad/s)" for n in ("gyr x", "gyr y", "gyr z"))
    rows = [f"{k / 50},0,0,9.8,0.1,0.2,{k}" for k in range(200)]
    path = tmp_path / "log.csv"

    def write(temperature: list[str]) -> None:
        lines = [f"{row},{t}" for row, t in zip(rows, temperature, strict=True)]
        path.write_text("\n".join([f"time (s),{head},temp (degC)", *lines, ""]))

    write(["nan"] * 200)
    parts = [read_recording(path), *open_batches(path, batch=64)]
    assert {part.temperature is None for part in parts} == {True}
    assert "left out" in parts[0].notes["temperature"]
    write(["nan"] * 199 + ["21.5"])
    with pytest.raises(InvalidSampleError, match="temperature is nan"):
        read_recording(path)
    with pytest.raises(InvalidSampleError, match=r"line 201: temperature is 21\.5, after rows"):
        list(open_batches(path, batch=64))
