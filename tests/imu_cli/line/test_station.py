"""Station files, and the history command on what stations wrote."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imu_cli.line.errors import StationError
from imu_cli.line.station import load_station
from imu_cli.line.store import History, ParameterRow, RunResult
from imu_cli.line.summary import summarise

STATION = """
[station]
name = "bench-1"
history = "sqlite:///history.db"

[device]
address = "emulator://witmotion?seed=1"

[record]
duration = "1.5 min"

[calibrate]
latitude = "52 deg"
height = 30

[limits]
"accel.bias" = { max_abs = "80 mg" }
"""


def written(folder: Path, text: str = STATION) -> Path:
    path = folder / "station.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_station_file_is_read_in_si(tmp_path: Path) -> None:
    station = load_station(written(tmp_path))
    assert station.duration == 90
    # Braunschweig (52.3 N, about 80 m) has a measured 9.8125 m/s²; normal gravity is near it.
    assert station.gravity == pytest.approx(9.8125, abs=1e-3)
    assert station.history == f"sqlite:///{tmp_path / 'history.db'}"
    assert not station.flash


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[record]", "[recrod]", "unknown table"),
        ('name = "bench-1"', "", "needs name"),
        ('name = "bench-1"', "name = 3", "text in quotes"),
        ("latitude", "lattitude", "unknown key"),
        ("height = 30", 'gravity = "9.8 m/s²"', "not both"),
        ("1.5 min", "1.5 g", "units of s"),
        ("1.5 min", "-5 s", r"\[record\] duration must be more than 0 s.*'-5 s'"),
        ("1.5 min", "0 s", "more than 0 s"),
        ("1.5 min", "1e999 s", "finite"),
        ("[limits]", '[verify]\nduration = "-5 s"\n[limits]', r"\[verify\] duration must be"),
        ("80 mg", "eighty", "is no quantity"),
        ("[device]", "[device", "no TOML"),
        ("[limits]", '[flash]\npersist = "no"\n[limits]', "true or false, without quotes"),
        ("[limits]", "[flash]\npersist = 0\n[limits]", "true or false"),
        ("[station]", "flash = false\n[station]", r"flash must be a table, \[flash\], got False"),
        ("height = 30", "height = true", "number of metres"),
        ("height = 30", 'height = "30 m"', "number of metres"),
    ],
)
def test_what_is_wrong_in_a_station_file_is_named(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in STATION
    with pytest.raises(StationError, match=message):
        load_station(written(tmp_path, STATION.replace(old, new)))


def test_a_missing_station_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(StationError, match="cannot be read"):
        load_station(tmp_path / "no.toml")


def fill(station_file: Path, *, units: int) -> None:
    station = load_station(station_file)
    history = History(station.history)
    rng = np.random.default_rng(4)
    now = datetime(2026, 1, 1, tzinfo=UTC)
    for k in range(units):
        run = history.begin(
            serial_number=f"U{k}",
            station="bench-1",
            fixture="",
            operator="",
            tool_version="0",
            now=now,
        )
        value = 3.0 if k == 5 else 0.1 * rng.normal()
        rows = [
            ParameterRow(name="accel.bias.x", value=value, standard_error=0.01, unit="m/s²"),
            ParameterRow(name="gyro.bias.x", value=0.001 * k + 0.001 * rng.normal(), unit="rad/s"),
        ]
        outcome = "FAIL" if k == 5 else "PASS"
        history.end(run, RunResult(outcome, parameters=rows), now=now)
        now += timedelta(hours=1)
    history.close()


def test_a_history_shows_yield_cpk_outliers_and_drift(tmp_path: Path) -> None:
    path = written(tmp_path)
    fill(path, units=20)
    station = load_station(path)
    history = History(station.history)
    summary = summarise(history.runs(), station.limits)
    history.close()
    assert summary["yield"] == 0.95
    assert [o["serial_number"] for o in summary["outliers"]] == ["U5"]
    assert [d["name"] for d in summary["drifts"]] == ["gyro.bias.x"]
    cpk = {row["name"]: row["cpk"] for row in summary["capability"]}
    assert cpk["gyro.bias.x"] is None  # no limit covers it
    assert cpk["accel.bias.x"] is not None
    json.dumps(summary, allow_nan=False)


def test_the_history_command_prints_a_unit_and_the_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from imu_cli.commands.history import history

    path = written(tmp_path)
    fill(path, units=9)
    history(path, as_json=True)
    assert json.loads(capsys.readouterr().out)["units"] == 9
    history(path, serial="U5", as_json=True)
    (attempt,) = json.loads(capsys.readouterr().out)["attempts"]
    assert attempt["outcome"] == "FAIL"
    history(path)
    assert "yield 88.9%" in capsys.readouterr().out
