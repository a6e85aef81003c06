"""Headers that name quantities, axes and units: read without a profile, or refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib import Recording
from calib.errors import EmptyRecordingError, RecordingFormatError
from calib.gravity import STANDARD_GRAVITY as G
from drivers.formats import open_batches, read_recording
from drivers.formats.header import column_of

DEG = np.pi / 180
VALUES = np.random.default_rng(3).normal(0, 1, (20, 6))
TIME = 12.0 + 0.01 * np.arange(20)


def read(folder: Path, header: str, *columns: np.ndarray, delimiter: str = ",") -> Recording:
    rows = "\n".join(delimiter.join(map(repr, row)) for row in np.column_stack(columns).tolist())
    path = folder / "a.csv"
    path.write_text(f"{header}\n{rows}\n", encoding="utf-8")
    return read_recording(path)


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        (
            "time (s),acc x (m/s²),acc y (m/s²),acc z (m/s²),"
            "gyr x (rad/s),gyr y (rad/s),gyr z (rad/s)",
            (1, 1, 1),
        ),
        ("t_us,ax_mg,ay_mg,az_mg,gx_dps,gy_dps,gz_dps", (1e-6, G / 1000, DEG)),
        ("Time [ms],AccX(g),AccY(g),AccZ(g),GyroX(°/s),GyroY(°/s),GyroZ(°/s)", (1e-3, G, DEG)),
        (
            "seconds,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s",
            (1, 1, 1),
        ),
        (
            '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)",'
            '"Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"',
            (1, 1, 1),
        ),
        (
            "timestamp_ns,linear acceleration,imu.acc.x [m s^-2],imu.acc.y [m s^-2],"
            "imu.acc.z [m s^-2],w_x [mdps],w_y [mdps],w_z [mdps]",
            (1e-9, 1, DEG / 1000),
        ),
    ],
)
def test_headers_that_say_enough(
    tmp_path: Path, header: str, scale: tuple[float, float, float]
) -> None:
    time, accel, gyro = scale
    extra = [np.zeros(20)] * ("linear" in header)
    recording = read(tmp_path, header, TIME, *extra, *VALUES.T)
    np.testing.assert_allclose(recording.time, TIME * time)
    np.testing.assert_allclose(recording.accel, VALUES[:, :3] * accel)
    np.testing.assert_allclose(recording.gyro, VALUES[:, 3:] * gyro)
    assert recording.notes["profile"] == "header (recognised from the file)"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_order_delimiter_temperature_and_batches(tmp_path: Path, delimiter: str) -> None:
    names = ["T (°F)", "mag_x", "gz (deg/s)", "gy (deg/s)", "gx (deg/s)", "az (g)", "ax (g)"]
    names += ["ay (g)", "t (s)"]
    heat = np.linspace(59.0, 77.0, 20)
    gyro, accel = VALUES[:, 3:], VALUES[:, :3]
    columns = [heat, heat, gyro[:, 2], gyro[:, 1], gyro[:, 0], accel[:, 2], *accel[:, :2].T, TIME]
    recording = read(tmp_path, delimiter.join(names), *columns, delimiter=delimiter)
    np.testing.assert_allclose(recording.accel, accel * G)
    np.testing.assert_allclose(recording.gyro, gyro * DEG)
    np.testing.assert_allclose(recording.temperature, np.linspace(15.0, 25.0, 20))
    parts = list(open_batches(tmp_path / "a.csv", batch=6))
    np.testing.assert_array_equal(np.concatenate([p.gyro for p in parts]), recording.gyro)


def test_a_header_alone_has_no_samples(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t_us,ax_mg,ay_mg,az_mg,gx_dps,gy_dps,gz_dps\n", encoding="utf-8")
    with pytest.raises(EmptyRecordingError, match="a header but no samples"):
        read_recording(path)


def test_dates_count_from_the_first(tmp_path: Path) -> None:
    header = "timestamp,ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)"
    rows = "".join(f"2026-11-26 12:00:{s:06.3f},0,0,1,1,2,3\n" for s in (1.5, 1.51, 1.52))
    (tmp_path / "a.csv").write_text(f"{header}\n{rows}")
    recording = read_recording(tmp_path / "a.csv")
    np.testing.assert_allclose(recording.time, [0.0, 0.01, 0.02], atol=1e-9)


@pytest.mark.parametrize(
    "header",
    [
        "t,ax,ay,az,gx,gy,gz",
        "time (s),ax,ay,az,gx (deg/s),gy (deg/s),gz (deg/s)",
        "time,ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)",
        "n,ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)",
        "time (s),ax (g),ay (g),az (mg),gx (deg/s),gy (deg/s),gz (deg/s)",
        "time (s),ax (g),ay (g),az (g),gx (g),gy (g),gz (g)",
        "time (s),ax (g),ay (g),ax (g),gx (deg/s),gy (deg/s),gz (deg/s)",
        "time (s),t_ms,ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)",
    ],
)
def test_headers_that_say_too_little(tmp_path: Path, header: str) -> None:
    """No unit, no time, two units, a wrong one, an axis or the time twice."""
    values = np.zeros((5, len(header.split(","))))
    with pytest.raises(RecordingFormatError, match=r"name the units there \(time \(s\), acc x"):
        read(tmp_path, header, *values.T)


@given(
    triad=st.sampled_from(
        [
            ("accel", ("a", "acc", "Accel_", "accelerometer ", "Acceleration."), "m/s^2 g mg"),
            (
                "gyro",
                ("g", "w", "gyr", "Gyro_", "gyroscope ", "omega.", "angular velocity "),
                "rad/s deg/s mdeg/s",
            ),
        ]
    ),
    form=st.integers(0, 6),
    axis=st.sampled_from("xyzXYZ"),
    first=st.booleans(),
    brackets=st.sampled_from(["{} ({})", "{}[{}]", "{} [ {} ]", "{}_{}"]),
    which=st.integers(0, 2),
)
def test_every_spelling_of_an_axis(
    triad: tuple[str, tuple[str, ...], str],
    form: int,
    axis: str,
    first: bool,
    brackets: str,
    which: int,
) -> None:
    quantity, forms, units = triad
    name, unit = forms[form % len(forms)], units.split()[which]
    base = f"{axis}_{name.strip(' ._')}" if first else f"{name}{axis}"
    assert column_of(brackets.format(base, unit)) == (quantity, axis.lower(), unit)


@given(st.text(max_size=30))
def test_any_text_is_a_column_or_none(name: str) -> None:
    known = column_of(name)
    assert known is None or known[0] in ("accel", "gyro", "time", "temperature")
