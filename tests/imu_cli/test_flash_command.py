"""`imu-cal flash` as its user meets it, and the whole loop around it."""

from __future__ import annotations

import errno
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.calibration import Calibration, Gravity
from calib.model import SensorModel
from drivers.calibration_file import load_calibration, save_calibration
from drivers.emulators.i2c_bus import Message
from drivers.flash.i2c import I2CTarget
from drivers.formats import read_recording
from drivers.transports import make_driver
from imu_cli import output
from imu_cli.app import app

RUN = CliRunner()
ENDS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
STILL = "emulator://mpu6050?rate=100&seed=4&speed=0"
URL = "emulator://mpu6050?rate=100&seed=5&motion=bench&speed=0"


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> I2CTarget:
    """One emulated device that stays powered from command to command."""
    driver = make_driver(URL)
    for module in ("drivers.transports.make_driver", "drivers.flash.make_driver"):
        monkeypatch.setattr(module, lambda url: driver)
    return I2CTarget(driver)  # type: ignore[arg-type]


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> I2CTarget:
    """One that lies still, and its perfect calibration in `unit.cal.json`."""
    driver = make_driver(STILL)
    for module in ("drivers.transports.make_driver", "drivers.flash.make_driver"):
        monkeypatch.setattr(module, lambda url: driver)
    target = I2CTarget(driver)  # type: ignore[arg-type]
    with target:
        (chip,) = driver._connect().models.values()  # type: ignore[attr-defined]
        model = chip.source(100.0).model
    names = [f"{triad}.bias.{axis}" for triad in ("accel", "gyro") for axis in "xyz"]
    calibration = Calibration(
        SensorModel(model.accel, model.gyro), tuple(names), np.eye(6) * 1e-10, (), Gravity(9.80665)
    )
    save_calibration(calibration, tmp_path / "unit.cal.json")
    return target


@pytest.fixture
def deaf() -> Iterator[None]:
    """Ignore what ends a process, as far as the command under test does not heed it."""
    before = {number: signal.signal(number, lambda n, frame: None) for number in ENDS}
    yield
    for number, old in before.items():
        signal.signal(number, old)


def signal_at_writes(target: I2CTarget, number: int, count: int) -> None:
    """Send a signal with each of the first writes of a gyroscope's bias."""
    left = iter(range(count))

    def fault(n: int, messages: tuple[Message, ...]) -> None:
        data = messages[0].data
        if len(messages) == 1 and data[0] == 0x14 and next(left, None) is not None:
            signal.raise_signal(number)

    target._driver._connect().fault = fault  # type: ignore[attr-defined]


def run(*words: str) -> tuple[int, str]:
    result = RUN.invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_the_whole_loop(device: I2CTarget, tmp_path: Path) -> None:
    """Record, calibrate, flash, record again: the bias is gone to a count and the noise."""
    log, cal = tmp_path / "log.arrow", tmp_path / "unit.cal.json"
    assert run("record", URL, "-o", str(log), "--duration", "200s")[0] == 0
    assert run("calibrate", str(log), "-o", str(cal))[0] == 0

    code, text = run("flash", str(cal), URL)
    assert code == 0
    assert "dry run: nothing was written" in text
    assert "XA_OFFS_H" in text
    assert not list(tmp_path.glob("backup*"))

    code, text = run("flash", str(cal), URL, "--yes", "--json")
    assert code == 0, text
    document = json.loads(text[text.index("{") :])
    assert document["written"]
    assert Path(document["backup"]).exists()
    left = load_calibration(tmp_path / "unit.left.json")
    assert document["left"] == str(tmp_path / "unit.left.json")

    after = tmp_path / "after.arrow"
    assert run("record", URL, "-o", str(after), "--duration", "20s")[0] == 0
    still = read_recording(after)
    lsb = 9.80665 / 1024, np.deg2rad(1 / 32.8)
    sigma = still.gyro.std(axis=0) / np.sqrt(len(still))
    assert np.abs(still.gyro.mean(axis=0)).max() < lsb[1] + 5 * sigma.max()
    # What is left corrects the accelerometer to gravity; the first calibration would do it twice.
    right = left.model.accel.correct(still.accel.mean(axis=0)[None])[0]
    wrong = load_calibration(cal).model.accel.correct(still.accel.mean(axis=0)[None])[0]
    assert np.linalg.norm(right) == pytest.approx(9.80665, abs=5e-3)
    assert abs(np.linalg.norm(wrong) - 9.80665) > 5e-3
    sizes = np.abs(left.model.accel.bias), np.abs(left.model.gyro.bias)
    assert sizes[0].max() <= lsb[0] / 2 * 1.01
    assert sizes[1].max() <= lsb[1] / 2 * 1.01

    code, text = run("flash", str(cal), URL, "--yes")
    assert code == 8
    assert "flashed already" in text
    code, text = run("flash", "--restore", document["backup"], URL)
    assert code == 0
    assert "restored and read back" in text


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.usefixtures("deaf")
def test_what_ends_a_process_puts_everything_back(
    number: int, still: I2CTarget, tmp_path: Path
) -> None:
    with still:
        old = still.read()
    signal_at_writes(still, number, 1)
    code, text = run("flash", str(tmp_path / "unit.cal.json"), STILL, "--yes")
    assert code == 8, text
    assert "interrupted. The old values are back" in text
    with still:
        assert still.read() == old


@pytest.mark.usefixtures("deaf")
def test_a_closed_terminal_keeps_nothing_from_being_put_back(
    still: I2CTarget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*words: object, **options: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with still:
        old = still.read()
    monkeypatch.setattr(output.messages(), "print", gone)
    signal_at_writes(still, signal.SIGHUP, 1)
    assert run("flash", str(tmp_path / "unit.cal.json"), STILL, "--yes")[0] == 8
    with still:
        assert still.read() == old


@pytest.mark.parametrize(
    ("left", "words", "message"),
    [
        ("unit.cal.json", [], "would be written over"),
        ("link.json", [], "would be written over"),
        ("backup.json", ["--backup", "backup.json"], "would be written over"),
        (".", [], "is a folder"),
        ("no/left.json", [], "is no folder that can be written to"),
    ],
)
def test_a_left_file_that_cannot_be_is_refused(
    left: str,
    words: list[str],
    message: str,
    still: I2CTarget,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("link.json").symlink_to("unit.cal.json")
    with still:
        old = still.read()
    code, text = run("flash", "unit.cal.json", STILL, "--yes", "--left", left, *words)
    assert code == 2, text
    assert message in " ".join(text.replace("│", " ").split())
    load_calibration("unit.cal.json")
    with still:
        assert still.read() == old


def test_a_full_disk_is_found_before_the_device_is_touched(
    still: I2CTarget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with still:
        old = still.read()

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    code, text = run("flash", str(tmp_path / "unit.cal.json"), STILL, "--yes")
    assert code == 10, text
    assert "No space left" in text
    assert [path.name for path in tmp_path.iterdir()] == ["unit.cal.json"]
    with still:
        assert still.read() == old


def test_a_left_file_that_fails_in_the_end_hides_no_flash(
    still: I2CTarget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with still:
        old = still.read()
    replace = os.replace

    def refuse(source: str, target: Path) -> None:
        if Path(target) == tmp_path / "unit.left.json":
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    code, text = run("flash", str(tmp_path / "unit.cal.json"), STILL, "--yes")
    assert code == 9, text
    for part in ("the device is flashed", "No space left", "--restore", "import smbus2"):
        assert part in text
    with still:
        assert still.read() != old


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["cal.json"], 2, "expected CAL.json URL"),
        (["a", "b", "c"], 2, "expected CAL.json URL"),
        (["--restore", "b.json", "a", "b"], 2, "expected --restore BACKUP URL"),
        (["cal.json", "emulator://mpu6050", "--persist"], 2, "are not stored"),
        (["missing.json", "emulator://mpu6050"], 10, "cannot read"),
        (["missing.json", "replay://x.arrow"], 2, ""),
        (["missing.json", "emulator://arduino"], 2, "add --template"),
        (["--restore", "missing.json", "emulator://mpu6050?speed=0"], 10, "cannot read"),
    ],
)
def test_wrong_usage(words: list[str], code: int, message: str) -> None:
    got, text = run("flash", *words)
    assert got == code, text
    assert message in " ".join(text.replace("│", " ").split())
