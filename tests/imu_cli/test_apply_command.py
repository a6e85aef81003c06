"""``imu-cal apply``: files of any format, streams, and what cannot be corrected."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.calibration import Calibration, Event, Gravity, TemperatureRange
from calib.effects.base import Term
from calib.model import SensorModel, Triad
from calib.recording import DeviceInfo, Recording
from drivers.calibration_file import load_calibration, save_calibration
from drivers.formats import read_recording, write_recording
from imu_cli.app import app

ACCEL = Triad(np.array([0.5, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
GYRO = Triad(
    np.array([0.25, 0.0, 0.0]), misalignment=np.array([[0, 0.01, 0], [0, 0, 0], [0, 0, 0]])
)
HEADER = "time,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z,temperature\n"


@pytest.fixture
def cal(tmp_path: Path) -> Path:
    calibration = Calibration(
        SensorModel(ACCEL, GYRO),
        (),
        np.zeros((0, 0)),
        (),
        Gravity(9.80665),
        temperature=TemperatureRange(20.0, 30.0),
        events=(Event("gyro_bias_step", ("gyro.x",), ((3.0, 4.0),)),),
    )
    path = tmp_path / "a.cal.json"
    save_calibration(calibration, path)
    return path


def recording(n: int = 1000, temperature: float = 25.0) -> Recording:
    rng = np.random.default_rng(0)
    return Recording(
        time=np.arange(n) * 0.01,
        accel=rng.normal(0, 9, (n, 3)),
        gyro=rng.normal(0, 1, (n, 3)),
        clock="device",
        temperature=np.full(n, temperature),
        lost=np.eye(1, n, 5, dtype=np.int64)[0],
        device=DeviceInfo("mpu6050", "7", accel_lsb=1e-3),
    )


def run(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["apply", *map(str, args)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize("suffix", [".arrow", ".csv", ".parquet"])
def test_a_file_is_corrected_whole(cal: Path, tmp_path: Path, suffix: str) -> None:
    measured, source, out = recording(), tmp_path / "a.arrow", tmp_path / f"b{suffix}"
    write_recording(measured, source)
    code, said, warned = run(cal, source, "-o", out)
    assert code == 0
    assert "1000 samples" in said
    assert "gyro_bias_step is not applied: at 3.00 to 4.00 s it is an event" in warned
    corrected = read_recording(out)
    np.testing.assert_allclose(corrected.accel, ACCEL.correct(measured.accel), atol=1e-12)
    np.testing.assert_allclose(corrected.gyro, GYRO.correct(measured.gyro), atol=1e-12)
    np.testing.assert_array_equal(corrected.lost, measured.lost)
    assert corrected.device.serial_number == "7"
    assert corrected.device.accel_lsb is None
    code, _, warned = run(cal, out, "-o", tmp_path / "c.csv")
    assert code == 3
    assert "already" in warned
    assert not (tmp_path / "c.csv").exists()


def test_outside_the_temperature_range_it_warns_and_goes_on(cal: Path, tmp_path: Path) -> None:
    write_recording(recording(temperature=35.0), tmp_path / "a.arrow")
    code, said, warned = run(cal, tmp_path / "a.arrow", "-o", tmp_path / "b.arrow", "--json")
    assert code == 0
    assert "1000 of 1000 samples are outside" in " ".join(warned.split())
    answer = json.loads(said)
    assert answer["outside_temperature_range"] == 1000
    assert [item["effect"] for item in answer["not_applied"]] == ["gyro_bias_step"]
    assert answer["warm_up_from"] is None


def with_terms(cal: Path, *terms: Term) -> Path:
    known = load_calibration(cal)
    path = cal.with_name("terms.cal.json")
    save_calibration(replace(known, model=replace(known.model, terms=terms), events=()), path)
    return path


TEMPERATURE = Term("gyro_bias_temperature", {"kx": 1e-3})
WARM_UP = Term("gyro_warm_up", {"kx": 1e-3, "tau": 60.0})


def test_a_term_of_temperature_is_not_applied_without_one_and_that_is_said(
    cal: Path, tmp_path: Path
) -> None:
    terms = with_terms(cal, TEMPERATURE)
    write_recording(replace(recording(), temperature=None), tmp_path / "a.arrow")
    code, said, warned = run(terms, tmp_path / "a.arrow", "-o", tmp_path / "b.arrow", "--json")
    assert code == 0
    assert "gyro_bias_temperature is not applied: the recording has no temperature" in warned
    assert json.loads(said)["not_applied"] == [
        {"effect": "gyro_bias_temperature", "reason": "the recording has no temperature"}
    ]
    write_recording(recording(), tmp_path / "c.arrow")
    code, said, warned = run(terms, tmp_path / "c.arrow", "-o", tmp_path / "b.arrow", "--json")
    assert json.loads(said)["not_applied"] == []
    assert "not applied" not in warned


def test_a_stream_without_temperature_is_told_so_once_and_events_before(cal: Path) -> None:
    known = load_calibration(cal)
    save_calibration(replace(known, model=replace(known.model, terms=(TEMPERATURE,))), cal)
    header = HEADER.replace(",temperature", "")
    result = CliRunner().invoke(app, ["apply", str(cal), "-"], input=header + "0,1,2,3,4,5,6\n")
    warned = " ".join(result.stderr.split())
    assert result.exit_code == 0
    assert warned.count("gyro_bias_temperature is not applied: the recording has no temp") == 1
    assert warned.count("gyro_bias_step is not applied") == 1
    nan = HEADER + "0,1,2,3,4,5,6,25\n" + "0.01,1,2,3,4,5,6,nan\n"
    result = CliRunner().invoke(app, ["apply", str(cal), "-"], input=nan)
    assert "is not applied: " not in result.stderr.replace("gyro_bias_step is not applied: ", "")


def test_temperatures_just_outside_the_range_are_told_apart_from_it(
    cal: Path, tmp_path: Path
) -> None:
    """It read "outside 20.0 to 30.0 °C (they go from 25.0 to 30.0 °C)"."""
    made = recording()
    warm = np.array(made.temperature)
    warm[-2:] = 30.004
    write_recording(replace(made, temperature=warm), tmp_path / "a.arrow")
    warned = " ".join(run(cal, tmp_path / "a.arrow", "-o", tmp_path / "b.arrow")[2].split())
    assert "2 of 1000 samples are outside the calibrated temperature" in warned
    assert "20.000 to 30.000 °C (they go from 25.000 to 30.004 °C)" in warned


def test_what_belongs_to_the_set_up_is_no_event(cal: Path, tmp_path: Path) -> None:
    """An arm to the reference was called an event of the recording."""
    known = load_calibration(cal)
    arm = Event("accel_lever_arm", ("accel.x",), ((0.0, 9.0),))
    save_calibration(replace(known, events=(*known.events, arm)), cal)
    write_recording(recording(), tmp_path / "a.arrow")
    _, said, warned = run(cal, tmp_path / "a.arrow", "-o", tmp_path / "b.arrow", "--json")
    assert "accel_lever_arm is not applied: it belongs to the set-up" in " ".join(warned.split())
    reasons = {item["effect"]: item["reason"] for item in json.loads(said)["not_applied"]}
    assert "set-up" in reasons["accel_lever_arm"]
    assert "event of the recording" in reasons["gyro_bias_step"]
    shown = CliRunner().invoke(app, ["show", str(cal)]).stdout
    assert "set-up       accel_lever_arm" in shown
    assert "event        gyro_bias_step" in shown


def test_from_when_a_warm_up_is_counted_is_said(cal: Path, tmp_path: Path) -> None:
    terms = with_terms(cal, WARM_UP)
    late = replace(recording(), time=recording().time + 12.5)
    write_recording(late, tmp_path / "a.arrow")
    said = run(terms, tmp_path / "a.arrow", "-o", tmp_path / "b.arrow")[1]
    assert "gyro_warm_up is counted from the first sample, at 12.50 s" in said
    said = run(terms, tmp_path / "a.arrow", "-o", tmp_path / "b.arrow", "--json")[1]
    assert json.loads(said)["warm_up_from"] == 12.5
    result = CliRunner().invoke(
        app, ["apply", str(terms), "-"], input=HEADER + "0,1,2,3,4,5,6,25\n"
    )
    assert "gyro_warm_up is counted from the first sample," in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (("none.arrow", "-o", "b.csv"), 3, "no file"),
        (("a.arrow",), 2, "name the recording to write"),
        (("a.arrow", "-o", "a.arrow"), 2, "is the recording itself"),
        (("a.arrow", "-o", "b.xyz"), 3, "suffix"),
        (("-", "-o", "b.csv"), 2, "a stream is CSV"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_is_written(
    cal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: tuple, code: int, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(recording(), tmp_path / "a.arrow")
    found, _, warned = run(cal, *args)
    assert found == code
    assert message in " ".join(warned.split())
    assert sorted(os.listdir(tmp_path)) == ["a.arrow", "a.cal.json"]


def test_a_nan_half_way_leaves_no_file(cal: Path, tmp_path: Path) -> None:
    lines = [f"{k / 100},1,2,3,4,5,6,25" for k in range(200)]
    lines[150] = "1.5,nan,2,3,4,5,6,25"
    (tmp_path / "a.csv").write_text(HEADER + "\n".join(lines) + "\n", encoding="utf-8")
    code, _, warned = run(cal, tmp_path / "a.csv", "-o", tmp_path / "b.csv")
    assert code == 3
    assert "nan" in warned
    assert not list(tmp_path.glob("b.csv*"))
    assert run(cal, tmp_path / "a.csv", "-o", tmp_path / "b.csv", "--drop-invalid")[0] == 0
    assert read_recording(tmp_path / "b.csv").samples_lost == 1


def test_a_stream_answers_line_by_line(cal: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "imu_cli", "apply", str(cal), "-"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.write(HEADER.encode())
        assert process.stdout.readline() == HEADER.encode()
        process.stdin.write(b"0.10,1.5,2,3,0.25,0,6,25.0\n")  # answered before the next is sent
        assert process.stdout.readline() == b"0.10,0.5,2,3,0,0,6,25.0\n"
        process.stdin.write(b"oops\n0.20,1.5,2,3,0.25,0,6,35.5\n")
        assert process.stdout.readline() == b"0.20,0.5,2,3,0,0,6,35.5\n"
        process.stdin.close()
        said = process.stderr.read().decode()
    assert process.returncode == 5
    assert "line 3 is left out" in said
    assert "1 of 2 samples are outside" in " ".join(said.split())


@pytest.mark.parametrize("data", [b"", b"no header at all\n", b"time,accel_x\n1,2\n"])
def test_a_stream_that_is_none_is_refused(cal: Path, data: bytes) -> None:
    result = CliRunner().invoke(app, ["apply", str(cal), "-"], input=data)
    assert result.exit_code == 3
    assert "expected the header" in " ".join(result.stderr.split())
