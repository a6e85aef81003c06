"""A unit through the station: four outcomes, one record, nothing else on standard output."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from calib.calibration import Calibration
from calib.errors import FlashError
from drivers.flash.procedure import Result as Flashed
from drivers.flash.target import Action, Plan
from drivers.record import RecordState
from imu_cli import output
from imu_cli.app import app
from imu_cli.line.station import load_station
from imu_cli.line.store import History

ROOT = Path(__file__).resolve().parents[3]
STATION = """
[station]
name = "bench-1"
operator = "night"

[device]
address = "emulator://witmotion?motion=bench&speed={speed}&seed=3&rate=50"

[record]
duration = "70 s"

[verify]
duration = "4 s"

[limits]
"accel.bias" = {{ max_abs = "{bias}" }}
"accel.residual_rms" = {{ max = "5 mg" }}
"""


def command(
    folder: Path, *, bias: str = "150 mg", speed: int = 0, more: tuple[str, ...] = ()
) -> list[str]:
    station = folder / "station.toml"
    station.write_text(STATION.format(bias=bias, speed=speed), encoding="utf-8")
    return ["run", str(station), "--serial", "A1", "--json", *more]


def run(folder: Path, *, bias: str = "150 mg", more: tuple[str, ...] = ()) -> Result:
    return CliRunner().invoke(app, command(folder, bias=bias, more=more), catch_exceptions=False)


def outcomes(folder: Path) -> list[str]:
    history = History(load_station(folder / "station.toml").history)
    runs = history.runs()
    history.close()
    return [run.outcome for run in runs]


def test_a_good_unit_passes_and_stands_in_the_history(tmp_path: Path) -> None:
    done = run(tmp_path)
    assert done.exit_code == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["outcome"], record["operator"], record["attempt"]) == ("PASS", "night", 1)
    names = [step["name"] for step in record["steps"]]
    assert names == ["record", "audit", "calibrate", "diagnose", "limits", "verify", "report"]
    for artefact in record["artefacts"].values():
        assert Path(artefact["path"]).is_file()
    assert "accel.bias.x" in record["parameters"]
    assert outcomes(tmp_path) == ["PASS"]


@pytest.mark.long
def test_a_unit_outside_its_limits_fails(tmp_path: Path) -> None:
    done = run(tmp_path, bias="1 mg")
    assert done.exit_code == 6, done.stderr
    record = json.loads(done.stdout)
    assert record["outcome"] == "FAIL"
    assert "accel.bias" in record["reason"]
    assert "verify" not in [step["name"] for step in record["steps"]]


def test_a_device_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    done = run(tmp_path, more=("--address", "serial:///dev/no-such-port"))
    assert done.exit_code == 11, done.stderr
    record = json.loads(done.stdout)
    assert record["outcome"] == "ERROR"
    assert record["reason"].startswith("record: ")
    assert outcomes(tmp_path) == ["ERROR"]


def test_a_closed_terminal_stops_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*words: object, **options: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(output.messages(), "print", gone)
    done = run(tmp_path, more=("--address", "serial:///dev/no-such-port"))
    assert done.exit_code == 11, done.stderr
    assert "no-such-port" in json.loads(done.stdout)["reason"]


def test_a_device_that_sends_nothing_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = RecordState(ended_by="end of the source")
    monkeypatch.setattr("imu_cli.line.run.record", lambda *arguments, **options: state)
    done = run(tmp_path)
    assert done.exit_code == 11, done.stderr
    record = json.loads(done.stdout)
    assert record["reason"].startswith("record: no sample came from emulator://witmotion")
    assert not record["artefacts"]
    assert outcomes(tmp_path) == ["ERROR"]


@pytest.mark.parametrize(
    ("number", "code", "printed"), [(signal.SIGINT, 130, True), (signal.SIGKILL, -9, False)]
)
@pytest.mark.long
def test_a_run_that_is_stopped_is_marked_aborted(
    tmp_path: Path, number: int, code: int, printed: bool
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "imu_cli", *command(tmp_path, speed=1)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    end = time.monotonic() + 30
    recording = tmp_path / "runs/A1/001/recording.arrow"
    while time.monotonic() < end and not recording.exists():
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(number)
    out, _ = process.communicate(timeout=30)
    assert process.returncode == code
    if printed:
        assert json.loads(out)["outcome"] == "ABORTED"
    else:
        assert out == ""
    # The next attempt at the unit starts clean, and says so in the history.
    run(tmp_path, more=("--address", "serial:///dev/no-such-port"))
    assert outcomes(tmp_path) == ["ABORTED", "ERROR"]


@pytest.mark.parametrize(
    ("count", "reason"),
    [
        (1, "stopped by the operator; the unit is flashed, and was not verified"),
        (2, "flash: interrupted. The old values are back, and were read back"),
    ],
)
def test_a_run_that_is_stopped_while_it_flashes_says_what_the_unit_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, reason: str
) -> None:
    def flash(
        target: None, calibration: Calibration, *, backup: Path, **options: object
    ) -> Flashed:
        backup.write_text("{}", encoding="utf-8")
        try:
            for _ in range(count):
                signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt as interrupt:
            text = "interrupted. The old values are back, and were read back"
            raise FlashError(text) from interrupt
        return Flashed(Plan((), {}, Action(), Action()), backup, (), calibration, False, "")

    monkeypatch.setattr("drivers.flash.make_target", lambda address: nullcontext())
    monkeypatch.setattr("drivers.flash.procedure.flash_device", flash)
    words = command(tmp_path)
    with (tmp_path / "station.toml").open("a", encoding="utf-8") as file:
        file.write("[flash]\n")
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 130, done.stderr
    record = json.loads(done.stdout)
    assert record["outcome"] == "ABORTED"
    assert record["reason"] == reason
    assert outcomes(tmp_path) == ["ABORTED"]


@pytest.mark.parametrize("serial", ["", "../A1", "a b"])
def test_a_serial_number_cannot_leave_its_folder(tmp_path: Path, serial: str) -> None:
    assert run(tmp_path, more=("--serial", serial)).exit_code == 2


@pytest.mark.long
def test_a_unit_is_flashed_and_verified_over_a_port(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    emulator = [sys.executable, "-m", "imu_cli", "emulate", "vectornav", "--motion", "bench"]
    with subprocess.Popen(
        [*emulator, "--seed", "11", "--speed", "20", "--rate", "50"],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as device:
        assert device.stdout is not None
        address = device.stdout.readline().strip()
        try:
            station = tmp_path / "station.toml"
            station.write_text(
                f'[station]\nname = "bench-1"\n[device]\naddress = "{address}"\n'
                '[record]\nduration = "185 s"\n[flash]\n[verify]\nduration = "10 s"\n',
                encoding="utf-8",
            )
            done = CliRunner().invoke(
                app, ["run", str(station), "--serial", "V1", "--json"], catch_exceptions=False
            )
        finally:
            device.terminate()
    assert done.exit_code == 0, done.stdout + done.stderr
    record = json.loads(done.stdout)
    assert record["outcome"] == "PASS"
    names = [step["name"] for step in record["steps"]]
    assert names.index("flash") < names.index("verify") < names.index("report")
    assert {"backup", "left", "verify", "report"} <= set(record["artefacts"])
