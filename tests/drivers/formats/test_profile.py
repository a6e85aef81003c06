"""Foreign text logs through import profiles: layouts, units, axes, clocks, and wrong profiles."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import Recording
from calib.errors import InvalidSampleError, RecordingError, RecordingFormatError
from calib.gravity import STANDARD_GRAVITY as G
from drivers.formats import open_batches, read_recording
from drivers.formats.profile import get_profile, parse_profile, shipped_profiles

RNG = np.random.default_rng
DEG = np.pi / 180


def plain(**lines: str) -> str:
    """Return a profile of six columns; keyword arguments replace or add whole tables."""
    tables = {
        "top": "rate = 100.0",
        "text": "",
        "accel": 'columns = [1, 2, 3]\nunit = "m/s^2"',
        "gyro": 'columns = [4, 5, 6]\nunit = "rad/s"',
    } | lines
    top = tables.pop("top")
    return "\n".join([top, *(f"[{name}]\n{text}" for name, text in tables.items())])


def read(tmp_path: Path, text: str, profile: str, **options: object) -> Recording:
    log, toml = tmp_path / "a.log", tmp_path / "p.toml"
    log.write_bytes(text.encode())
    toml.write_text(profile, encoding="utf-8")
    return read_recording(log, profile=str(toml), **options)  # type: ignore[arg-type]


def rows(values: np.ndarray, delimiter: str = ",") -> str:
    return "".join(delimiter.join(repr(float(v)) for v in row) + "\n" for row in values)


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 40),
    delimiter=st.sampled_from([",", ";", "\t", " ", "   ", ", "]),
    end=st.sampled_from(["\n", "\r\n"]),
    header=st.booleans(),
    skip=st.integers(0, 3),
    batch=st.integers(1, 20),
)
@settings(max_examples=60, deadline=None)
def test_every_layout_reads_the_same(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    n: int,
    delimiter: str,
    end: str,
    header: bool,
    skip: int,
    batch: int,
) -> None:
    values = RNG(seed).normal(0, 10, (n, 6))
    text = "a comment that is no number\n" * skip
    text += delimiter.join(["ax", "ay", "az", "gx", "gy", "gz"]) + "\n" if header else ""
    text = (text + rows(values, delimiter)).replace("\n", end)
    layout = f"skip_lines = {skip}\nheader = {str(header).lower()}\n"
    layout += f'delimiter = "{delimiter.strip() or " "}"' if delimiter != "\t" else ""
    path = tmp_path_factory.mktemp("layout")
    recording = read(path, text, plain(text=layout))
    np.testing.assert_array_equal(recording.accel, values[:, :3])
    np.testing.assert_array_equal(recording.gyro, values[:, 3:])
    np.testing.assert_array_equal(recording.time, np.arange(n) / 100)
    assert recording.clock == "nominal"
    parts = list(open_batches(path / "a.log", profile=str(path / "p.toml"), batch=batch))
    np.testing.assert_array_equal(np.concatenate([p.gyro for p in parts]), recording.gyro)
    np.testing.assert_array_equal(np.concatenate([p.time for p in parts]), recording.time)


@pytest.mark.parametrize(
    ("unit", "factor"), [("m/s^2", 1.0), ("g", G), ("mg", G / 1e3), ("LSB", G / 8192)]
)
def test_accelerometer_units(tmp_path: Path, unit: str, factor: float) -> None:
    values = RNG(0).integers(-9000, 9000, (20, 6)).astype(float)
    sensitivity = "sensitivity = 8192" if unit == "LSB" else ""
    accel = f'columns = [1, 2, 3]\nunit = "{unit}"\n{sensitivity}\nfull_scale = 4'
    recording = read(tmp_path, rows(values), plain(accel=accel))
    np.testing.assert_allclose(recording.accel, values[:, :3] * factor, rtol=1e-14)
    assert recording.device.accel_full_scale == pytest.approx(4 * G)
    assert recording.device.accel_lsb == (pytest.approx(factor) if unit == "LSB" else None)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("rad/s", 1.0), ("deg/s", DEG), ("dps", DEG), ("mdeg/s", DEG / 1e3), ("LSB", DEG / 65.5)],
)
def test_gyroscope_units(tmp_path: Path, unit: str, factor: float) -> None:
    values = RNG(1).normal(0, 100, (20, 6))
    sensitivity = "sensitivity = [65.5, 65.5, 65.5]" if unit == "LSB" else ""
    gyro = f'columns = [4, 5, 6]\nunit = "{unit}"\n{sensitivity}\nfull_scale = 500'
    recording = read(tmp_path, rows(values), plain(gyro=gyro))
    np.testing.assert_allclose(recording.gyro, values[:, 3:] * factor, rtol=1e-14)
    assert recording.device.gyro_full_scale == pytest.approx(500 * DEG)


def test_axes_turn_the_sensor_and_columns_may_stand_anywhere(tmp_path: Path) -> None:
    values = RNG(2).normal(size=(10, 8))
    accel = 'columns = [8, 2, 3]\nunit = "m/s^2"\naxes = ["-y", "x", "z"]'
    recording = read(tmp_path, rows(values), plain(accel=accel))
    expected = np.stack([-values[:, 1], values[:, 7], values[:, 2]], axis=1)
    np.testing.assert_array_equal(recording.accel, expected)


def test_temperature_units_and_words_in_other_columns(tmp_path: Path) -> None:
    values = RNG(3).normal(size=(4, 6))
    for unit, raw, extra in [("degF", 77.0, ""), ("K", 298.15, "")]:
        text = "".join(f"{line},{raw},ok\n" for line in rows(values).splitlines())
        table = f'column = 7\nunit = "{unit}"\n{extra}'
        recording = read(tmp_path, text, plain(temperature=table))
        np.testing.assert_allclose(recording.temperature, 25.0)
    text = "".join(f"{line},-340,ok\n" for line in rows(values).splitlines())
    table = 'column = 7\nunit = "LSB"\nsensitivity = 340\nzero = 36.53'
    recording = read(tmp_path, text, plain(temperature=table))
    np.testing.assert_allclose(recording.temperature, 35.53)


@pytest.mark.parametrize(
    ("unit", "stamps", "first"),
    [
        ('"s"', ["12.5", "12.51", "12.53"], 12.5),
        ('"ms"', ["12500", "12510", "12530"], 12.5),
        ('"us"', ["12500000", "12510000", "12530000"], 12.5),
        ('"ns"', ["1700000000000000001", "1700000000010000001", "1700000000030000001"], 0),
        ("64000000", ["0", "640000", "1920000"], 0),
        (
            '"iso8601"',
            ["2026-01-01 00:00:00.000", "2026-01-01 00:00:00.010", "2026-01-01 00:00:00.030"],
            0,
        ),
    ],
)
def test_clocks(tmp_path: Path, unit: str, stamps: list[str], first: float) -> None:
    """Seconds are those of the file, but for dates and what counts from an epoch."""
    text = "".join(f"1,2,3,4,5,6,{stamp}\n" for stamp in stamps)
    recording = read(tmp_path, text, plain(top="", time=f"column = 7\nunit = {unit}"))
    np.testing.assert_allclose(recording.time - first, [0, 0.01, 0.03], atol=1e-12)
    assert recording.clock == "device"


def test_seconds_since_an_epoch_count_from_the_first(tmp_path: Path) -> None:
    text = "".join(f"1,2,3,4,5,6,{1.7e9 + s}\n" for s in (0.25, 0.5, 1.0))
    recording = read(tmp_path, text, plain(top="", time='column = 7\nunit = "s"'))
    assert recording.time.tolist() == [0.0, 0.25, 0.75]


@pytest.mark.parametrize("number", [10, 11, 12, 101])
def test_seconds_are_whole_in_some_lines(tmp_path: Path, number: int) -> None:
    time = np.arange(number) / 10
    text = "".join(f"{t:.9g},1,2,3,4,5,6\n" for t in time)
    profile = plain(
        top="",
        time='column = 1\nunit = "s"',
        accel='columns = [2, 3, 4]\nunit = "m/s^2"',
        gyro='columns = [5, 6, 7]\nunit = "rad/s"',
    )
    np.testing.assert_array_equal(read(tmp_path, text, profile).time, time)


def test_a_counter_that_wraps_runs_on(tmp_path: Path) -> None:
    true = np.arange(0, 40) * 10_000 + 2**32 - 55_000
    text = "".join(f"1,2,3,4,5,6,{stamp % 2**32}\n" for stamp in true)
    profile = plain(top="", time='column = 7\nunit = "us"\nwraps = 4294967296')
    recording = read(tmp_path, text, profile)
    np.testing.assert_allclose(np.diff(recording.time), 0.01, atol=1e-12)
    parts = list(open_batches(tmp_path / "a.log", profile=str(tmp_path / "p.toml"), batch=3))
    np.testing.assert_array_equal(np.concatenate([p.time for p in parts]), recording.time)
    with pytest.raises(InvalidSampleError, match="time does not increase"):
        read(tmp_path, text, profile.replace("wraps = 4294967296", ""))


def test_decimal_comma(tmp_path: Path) -> None:
    text = "1,5;2;3;4;5;6,25\n" * 3
    recording = read(tmp_path, text, plain(text='decimal = ","\ndelimiter = ";"'))
    assert recording.accel[0, 0] == 1.5
    assert recording.gyro[0, 2] == 6.25


def test_accelerometer_and_gyroscope_in_two_files(tmp_path: Path) -> None:
    def line(t: np.ndarray) -> np.ndarray:
        return np.stack([t, 2 * t, 3 * t], axis=1)

    ta = np.arange(0.0, 4.0, 0.02)
    tg = np.arange(0.5, 5.0, 0.01)
    ta = np.delete(ta, slice(100, 125))
    for name, t in (("acc", ta), ("gyr", tg)):
        table = np.column_stack([t + 100, line(t)])
        (tmp_path / f"{name}.txt").write_text("t;x;y;z\n" + rows(table, ";"))
    profile = plain(
        top="",
        text='files = "accel,gyro"\nheader = true',
        time='column = "t"',
        accel='columns = ["x", "y", "z"]\nunit = "m/s^2"',
        gyro='columns = ["x", "y", "z"]\nunit = "deg/s"',
    )
    (tmp_path / "p.toml").write_text(profile)
    both = [tmp_path / "acc.txt", tmp_path / "gyr.txt"]
    recording = read_recording(both, profile=str(tmp_path / "p.toml"))
    np.testing.assert_allclose(recording.accel, line(recording.time - 100), atol=1e-9)
    np.testing.assert_allclose(recording.gyro, line(recording.time - 100) * DEG, atol=1e-9)
    assert recording.time[0] == pytest.approx(100.5)
    assert recording.time[-1] == pytest.approx(100 + ta[-1], abs=0.011)
    assert np.diff(recording.time).max() == pytest.approx(0.52, abs=0.011)
    assert recording.samples_lost == pytest.approx(51, abs=1)
    assert "interpolated" in recording.notes["resampled"]
    with pytest.raises(RecordingFormatError, match="pairs of files"):
        read_recording(both[:1], profile=str(tmp_path / "p.toml"))


def test_one_file_per_pose(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(plain())
    paths = []
    for k in range(3):
        paths.append(tmp_path / f"pose{k}.log")
        paths[-1].write_text(rows(np.full((50, 6), float(k))))
    recording = read_recording(paths, profile=str(tmp_path / "p.toml"))
    assert len(recording) == 150
    assert np.flatnonzero(recording.lost).tolist() == [50, 100]
    assert recording.time[50] - recording.time[49] == pytest.approx(1.0)
    assert np.asarray(recording.lost)[50] == 99
    np.testing.assert_array_equal(recording.accel[:, 0], np.repeat([0.0, 1.0, 2.0], 50))


def test_the_shipped_profiles_say_what_they_are_for() -> None:
    assert {"mpu9150", "mpu6050", "thermal", "mimu4444", "broad"} <= set(shipped_profiles())
    assert all(profile.description for profile in shipped_profiles().values())


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ("rate = ", "is no TOML"),
        (plain(top=""), r"no \[time\] and no rate"),
        (plain(accel='columns = [1, 2]\nunit = "g"'), r"\[accel\]: columns must be three"),
        (plain(accel='columns = [1, 2, 3]\nunit = "feet"'), "unit must be one of m/s"),
        (plain(accel='columns = [1, 2, 3]\nunit = "LSB"'), "sensitivity must be the counts"),
        (plain(accel='columns = [1, 2, 3]\nunit = "g"\nsensitivity = 2'), "left out where"),
        (plain(gyro='columns = [4, 5, 6]\nunit = "dps"\naxes = ["x", "x", "z"]'), "axes must be"),
        (plain(text="skiplines = 1"), "unknown key 'skiplines'"),
        (plain(top="rate = -5"), "rate must be a number"),
        (plain(recognise="pattern = '('"), "pattern must be a regular expression"),
        (plain(top="", time='column = 1\nunit = "days"'), "unit must be one of s, ms"),
        ("rate = 100", r"neither \[accel\] nor \[gyro\]"),
    ],
)
def test_a_wrong_profile_is_refused_by_its_key(profile: str, message: str) -> None:
    with pytest.raises(RecordingFormatError, match=message):
        parse_profile(profile, name="mine")


def test_a_profile_that_does_not_fit_the_file(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingFormatError, match="no column 4; separated by ',' its columns are 1, 2, 3"
    ):
        read(tmp_path, "1,2,3\n4,5,6\n", plain())
    with pytest.raises(RecordingFormatError, match="no import profile 'nonesuch'; shipped are"):
        get_profile("nonesuch")


@given(st.text(max_size=300))
@settings(max_examples=150, deadline=None)
def test_no_text_makes_a_traceback(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.log"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    for profile in (None, "mpu9150"):
        said = ""
        try:
            assert np.isfinite(read_recording(path, profile=profile).accel).all()
        except RecordingError as refused:
            said = str(refused)
        assert not said or str(path) in said
