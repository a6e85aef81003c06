"""CSV and binary files from elsewhere: layouts, cuts at any byte, wrong units, devices, HDF5."""

import os
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import DeviceInfo, Recording
from calib.errors import RecordingError, RecordingFormatError, RecordingWriteError
from drivers.formats import formats, open_writer, read_recording, write_recording
from drivers.formats.columns import CHANNEL_COLUMNS, REQUIRED, schema_of, to_batch
from tests.drivers.formats.test_formats import a_recording, same

RNG = np.random.default_rng
DATA = Path(os.environ.get("IMU_CAL_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))

finite = st.floats(-1e9, 1e9, allow_subnormal=False)
text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)


@given(
    values=st.lists(st.tuples(*[finite] * 7), min_size=1, max_size=8),
    notes=st.dictionaries(text.filter(bool), text, max_size=3),
    chip=text,
    suffix=st.sampled_from([".csv", ".arrow", ".parquet", ".feather"]),
)
@settings(max_examples=80, deadline=None)
def test_any_recording_survives_any_format(
    tmp_path_factory: pytest.TempPathFactory,
    values: list[tuple[float, ...]],
    notes: dict[str, str],
    chip: str,
    suffix: str,
) -> None:
    table = np.array(values)
    recording = Recording(
        time=np.cumsum(np.abs(table[:, 6]) + 1e-3),
        accel=table[:, :3],
        gyro=table[:, 3:6],
        clock="host",
        device=DeviceInfo(chip=chip, rate=123.456),
        notes=notes,
    )
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    write_recording(recording, path)
    same(read_recording(path), recording)


@given(cut=st.integers(1, 4000))
@settings(max_examples=60, deadline=None)
def test_a_csv_cut_at_any_byte_reads_to_its_last_whole_line(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    recording = a_recording(40)
    path = tmp_path_factory.getbasetemp() / "cut.csv"
    write_recording(recording, path)
    data = path.read_bytes()
    cut = min(cut, len(data) - 1)
    path.write_bytes(data[:-cut])
    lines = data[:-cut].count(b"\n") - data[: data.index(b"time,")].count(b"\n") - 1
    if lines < 1:
        with pytest.raises(RecordingError):
            read_recording(path)
        return
    part = read_recording(path)
    assert len(part) == lines
    np.testing.assert_array_equal(part.accel, recording.accel[:lines])
    assert part.complete == data[:-cut].endswith(b"\n")


def test_columns_in_any_order_more_columns_and_comments(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    names = [*reversed(REQUIRED), "remark"]
    body = "".join(f"1,2,3,4,5,6,{k},word\n" for k in range(3))
    path.write_text(
        f"\ufeff# serial_number: 7\n#operator: Ann\n# rate: 50\n{','.join(names)}\n{body}",
        encoding="utf-8",
    )
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.time, [0, 1, 2])
    np.testing.assert_array_equal(recording.accel[0], [6, 5, 4])
    np.testing.assert_array_equal(recording.gyro[0], [3, 2, 1])
    assert (recording.device.serial_number, recording.device.rate) == ("7", 50.0)
    assert recording.notes["operator"] == "Ann"
    path.write_text("# rate: fast\n" + path.read_text("utf-8").partition("50\n")[2])
    with pytest.raises(RecordingFormatError, match="rate is 'fast', expected"):
        read_recording(path)


def test_an_arrow_file_of_someone_else(tmp_path: Path) -> None:
    schema = schema_of(a_recording())
    batch = to_batch(a_recording(), schema)
    path = tmp_path / "a.arrow"

    def write(table: pa.RecordBatch) -> None:
        with pa.ipc.new_stream(str(path), table.schema) as stream:
            stream.write_batch(table)

    single = pa.record_batch(
        {name: batch.column(name).cast(pa.float32(), safe=False) for name in CHANNEL_COLUMNS}
        | {"time": batch.column("time")}
    )
    write(single)
    np.testing.assert_allclose(read_recording(path).accel, a_recording().accel, rtol=1e-6)
    write(batch.drop_columns(["gyro_z"]))
    with pytest.raises(RecordingFormatError, match="no column gyro_z"):
        read_recording(path)
    at = schema.get_field_index("gyro_x")
    wrong = schema.set(at, schema.field(at).with_metadata({"unit": "deg/s"}))
    write(batch.cast(wrong))
    with pytest.raises(RecordingFormatError, match="gyro_x is in deg/s, expected rad/s"):
        read_recording(path)


@pytest.mark.parametrize("suffix", [".parquet", ".feather", ".arrow"])
def test_damaged_binary_files_say_so(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_recording(a_recording(), path)
    data = path.read_bytes()
    for cut in (60, len(data) // 2):
        path.write_bytes(data[:cut])
        with pytest.raises(RecordingError, match=r"damaged|no samples|no Arrow|no Parquet"):
            read_recording(path)
    path.write_bytes(b"not at all " * 30)
    with pytest.raises(RecordingFormatError, match="starts with"):
        read_recording(path)


def test_options_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.arrow"
    write_recording(a_recording(), path)
    with pytest.raises(RecordingFormatError, match="leave --profile mpu9150 away"):
        read_recording(path, profile="mpu9150")
    with pytest.raises(RecordingFormatError, match="holds one sensor, and --imu 3"):
        read_recording(path, imu=3)
    other = tmp_path / "b.csv"
    write_recording(replace(a_recording(), device=DeviceInfo("BMI160")), other)
    with pytest.raises(RecordingFormatError, match="expected files of one device"):
        read_recording([path, other])
    write_recording(a_recording(temperature=False), other)
    with pytest.raises(RecordingFormatError, match="has no temperature, the file before it"):
        read_recording([path, other])
    os.rename(path, tmp_path / "a.csv")
    with pytest.raises(RecordingFormatError, match=r"holds Arrow IPC stream .* expected text"):
        read_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("suffix", [".csv", ".arrow", ".parquet", ".feather"])
def test_a_writer_that_fails_leaves_nothing_behind(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"

    def fail() -> None:
        with open_writer(path, atomic=True) as writer:
            writer.append(a_recording())
            writer.append(a_recording())

    with pytest.raises(ValueError, match="`batch` must go on after"):
        fail()
    with open_writer(path) as nothing:
        assert nothing.path == path
    assert not list(tmp_path.iterdir())
    if os.path.exists("/dev/full"):
        (tmp_path / f"a{suffix}.part").symlink_to("/dev/full")
        with pytest.raises(RecordingWriteError, match="cannot be written: No space left"):
            write_recording(a_recording(20_000), path)
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".csv", ".arrow", ".parquet", ".feather"])
def test_what_interrupts_the_opening_of_a_file_leaves_nothing_behind(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal that came just then left an empty `.part`, one time in many."""
    writer = open_writer(tmp_path / f"a{suffix}", atomic=True)
    opened = writer._start

    def interrupted(batch: Recording) -> None:
        opened(batch)
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_start", interrupted)
    with pytest.raises(KeyboardInterrupt), writer:
        writer.append(a_recording())
    assert not list(tmp_path.iterdir())
    writer._abandon()  # what a process that ends would close


def test_a_pipe_can_be_read(tmp_path: Path) -> None:
    write_recording(a_recording(), tmp_path / "a.csv")
    data, pipe = (tmp_path / "a.csv").read_bytes(), tmp_path / "pipe.csv"
    if not hasattr(os, "mkfifo"):
        pytest.skip("no named pipes on this system")
    os.mkfifo(pipe)
    thread = threading.Thread(target=pipe.write_bytes, args=(data,))
    thread.start()
    same(read_recording(pipe), a_recording())
    thread.join()


def test_hdf5_through_profiles(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path, values = tmp_path / "a.hdf5", RNG(0).normal(size=(50, 6))
    with h5py.File(path, "w") as file:
        file["imu_acc"], file["imu_gyr"] = values[:, :3], values[:, 3:]
        file.attrs["sampling_rate"] = 250.0
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.gyro, values[:, 3:])
    np.testing.assert_allclose(recording.time, np.arange(50) / 250)
    assert recording.notes["profile"] == "broad (recognised from the file)"
    profile = tmp_path / "p.toml"
    profile.write_text(
        'format = "hdf5"\n[accel]\ncolumns = "a"\nunit = "g"\n[gyro]\ncolumns = "w"\nunit = "dps"\n'
        '[time]\ncolumn = "t"\nunit = "ms"\n[temperature]\ncolumn = "T"\n'
    )
    with pytest.raises(RecordingFormatError, match=r"no data set 'a' among imu_acc, imu_gyr"):
        read_recording(path, profile=str(profile))
    with h5py.File(path, "w") as file:
        file["a"], file["w"], file["t"] = values[:, :3], values[:, 3:], np.arange(50) * 4.0
        file["T"] = np.full(50, 30.0)
    recording = read_recording(path, profile=str(profile))
    np.testing.assert_allclose(recording.accel, values[:, :3] * 9.80665)
    np.testing.assert_allclose(recording.time, np.arange(50) * 0.004, atol=1e-12)
    with pytest.raises(RecordingFormatError, match="which no shipped profile knows"):
        read_recording(path)
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(RecordingFormatError, match="damaged HDF5"):
        read_recording(path)


def test_every_format_has_a_title_and_its_own_suffixes() -> None:
    taken: set[str] = set()
    for item in formats().values():
        assert item.title
        own = set(item.suffixes) if item.binary else set()
        assert not own & taken
        taken |= own
    writable = [s for f in formats().values() if f.writer is not None for s in f.suffixes]
    assert len(writable) == len(set(writable))


@pytest.mark.parametrize(
    ("name", "options", "samples", "gravity"),
    [
        ("mpu9150/imu0.log", {"profile": "mpu9150"}, 15969, 9.86),
        ("mpu6050/example_data_tinit_calc.csv", {}, 44930, 9.0),
        ("thermal/imu_raw_data.csv", {}, 8400, 9.5),
        ("mimu4444/exp_1/data.bin", {"imu": 4}, 37439, 9.8),
        ("broad/07_undisturbed_fast_rotation_B.hdf5", {}, 52518, 9.82),
    ],
)
def test_the_public_logs(
    name: str, options: dict[str, object], samples: int, gravity: float
) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no {path}: the public logs are not part of the project")
    recording = read_recording(path, **options)  # type: ignore[arg-type]
    assert len(recording) == samples
    norm = np.linalg.norm(recording.accel[:300], axis=1).mean()
    assert norm == pytest.approx(gravity, rel=0.05)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_damage_is_refused_or_read_but_never_a_traceback(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    suffix = data.draw(st.sampled_from([".csv", ".arrow", ".parquet", ".feather"]))
    path = tmp_path_factory.getbasetemp() / f"damaged{suffix}"
    write_recording(a_recording(15), path)
    damaged = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at : at + data.draw(st.integers(0, 20))] = data.draw(st.binary(max_size=20))
    path.write_bytes(bytes(damaged))
    try:
        assert np.isfinite(read_recording(path).accel).all()
    except RecordingError as refused:
        said = str(refused)
        assert str(path) in said
