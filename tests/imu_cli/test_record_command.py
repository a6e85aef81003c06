"""``imu-cal record``, ``emulate`` and ``devices`` as a user meets them: processes and signals."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.formats import read_recording
from imu_cli.app import app

PtyFactory = Callable[..., Any]
IMU_CAL = [sys.executable, "-m", "imu_cli"]
RUN = CliRunner()


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    running = []

    def launch(*words: str) -> subprocess.Popen[str]:
        running.append(
            subprocess.Popen(
                [*IMU_CAL, *words],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env={**os.environ, "COLUMNS": "200"},
            )
        )
        return running[-1]

    yield launch
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for_size(path: Path, size: int) -> None:
    deadline = time.monotonic() + 15
    while not path.exists() or path.stat().st_size < size:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_emulate_record_and_the_ends_of_both(start: Any, tmp_path: Path) -> None:
    device = start("emulate", "vectornav", "--rate", "400", "--seed", "3")
    address = device.stdout.readline().strip()
    assert address.startswith("serial:///dev/")
    interrupted, killed = tmp_path / "interrupted.arrow", tmp_path / "killed.arrow"
    recorder = start("record", address, "-o", str(interrupted), "--json")
    wait_for_size(interrupted, 20_000)
    recorder.send_signal(signal.SIGINT)
    out, err = recorder.communicate(timeout=10)
    assert recorder.returncode == 0, err
    report = json.loads(out)
    assert report["ended_by"] == "interrupt"
    log = read_recording(interrupted)
    assert len(log) == report["samples"]
    assert log.complete

    recorder = start("record", address, "-o", str(killed))
    wait_for_size(killed, 20_000)
    wait_for_size(killed, killed.stat().st_size + 30_000)
    alive = time.time()
    recorder.kill()
    recorder.wait()
    log = read_recording(killed)
    assert not log.complete
    assert np.allclose(np.diff(log.time), 1 / 400, atol=1e-6)
    assert alive - killed.stat().st_mtime < 1.5
    info = RUN.invoke(app, ["info", str(killed)])
    assert "cut" in info.output

    device.send_signal(signal.SIGINT)
    assert device.wait(timeout=5) == 0


def test_a_device_that_goes_away_is_exit_7(start: Any, tmp_path: Path) -> None:
    device = start("emulate", "arduino", "--rate", "400")
    address = device.stdout.readline().strip()
    log = tmp_path / "log.csv"
    recorder = start("record", address, "-o", str(log))
    wait_for_size(log, 5_000)
    device.kill()
    out, err = recorder.communicate(timeout=10)
    assert recorder.returncode == 7
    assert out == ""
    assert "went away" in err
    assert "--reconnect" in err
    assert len(read_recording(log)) > 10


def test_strict_fails_on_any_loss(tmp_path: Path) -> None:
    from drivers.emulators.base import EmulatorOptions, make_sensor
    from drivers.emulators.vectornav import VectorNavDevice

    device = VectorNavDevice(make_sensor(EmulatorOptions(), default_rate=100.0), binary=True)
    whole = tmp_path / "whole.bin"
    whole.write_bytes(device.stream(0, 100))
    damaged = bytearray(whole.read_bytes())
    damaged[1000] ^= 1
    broken = tmp_path / "broken.bin"
    broken.write_bytes(damaged)
    for path, code in ((whole, 0), (broken, 6)):
        url = f"replay://{path}?dialect=vectornav&speed=0"
        words = ["record", url, "-o", f"{path}.arrow", "--strict"]
        assert RUN.invoke(app, words).exit_code == code
    assert read_recording(tmp_path / "broken.bin.arrow").samples_lost == 1
    result = RUN.invoke(app, ["record", url, "-o", str(tmp_path / "b.csv")])
    assert result.exit_code == 0
    assert "1 samples lost" in result.stderr
    assert "1 damaged frames" in result.stderr
    for name in ("broken.bin.arrow", "b.csv"):
        assert read_recording(tmp_path / name).notes["damaged frames"] == "1"


def test_samples_json_and_existing_files(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    words = ["record", "emulator://arduino?speed=0", "-o", str(log), "--samples", "25", "--json"]
    result = RUN.invoke(app, words)
    report = json.loads(result.stdout)
    assert (report["samples"], report["clock"], report["lost"]) == (25, "device", 0)
    assert len(read_recording(log)) == 25
    again = RUN.invoke(app, words)
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr
    assert RUN.invoke(app, [*words, "--overwrite"]).exit_code == 0


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["record", "/dev/ttyUSB0", "-o", "a.csv"], 2, "serial:///dev/ttyUSB0"),
        (["record", "emulator://arduino", "-o", "a.csv", "--duration", "soon"], 2, "no duration"),
        (["record", "emulator://arduino", "-o", "a.xyz"], 3, "a.xyz"),
        (["record", "emulator://nothing", "-o", "a.csv"], 2, "arduino"),
        (["record", "emulator://arduino?noise=1", "-o", "a.csv"], 2, "known here"),
        (["record", "serial:///dev/ttyNOT0", "-o", "a.csv"], 7, "no serial port"),
        (["record", "replay://none.arrow", "-o", "a.csv"], 3, "none.arrow"),
        (
            ["record", "emulator://arduino", "-o", "a.csv", "--duration", "1s", "--samples", "2"],
            2,
            "not both",
        ),
        (["record", "emulator://arduino", "-o", "a.csv", "--raw", "a.csv"], 2, "two files"),
        (["record", "emulator://mpu6050", "-o", "a.csv", "--raw", "b"], 2, "no stream of bytes"),
        (["record", "replay://none.csv", "-o", "a.csv", "--raw", "b"], 2, "no stream of bytes"),
        (["emulate", "toaster"], 2, "witmotion"),
        (["emulate", "arduino", "--motion", "dance"], 2, "bench"),
    ],
)
def test_wrong_words(
    words: list[str], code: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = RUN.invoke(app, words)
    assert result.exit_code == code, result.output
    assert says in " ".join(result.stderr.split())
    assert not (tmp_path / "a.csv").exists()


def test_lists() -> None:
    names = {item["name"] for item in json.loads(RUN.invoke(app, ["emulate", "--json"]).stdout)}
    assert {"witmotion", "vectornav", "px4", "ardupilot", "arduino", "mpu6050"} <= names
    document = json.loads(RUN.invoke(app, ["devices", "--json"]).stdout)
    assert document["format"] == "imu-cal/devices"
    assert RUN.invoke(app, ["devices"]).exit_code == 0


def test_progress_says_all_that_matters() -> None:
    from collections import Counter

    from drivers.record import RecordState
    from imu_cli.recording_view import progress_line

    state = RecordState(samples=10, lost=2, duration=1.5, rate=8.0, clipped=1, temperature=31.25)
    state.moving, state.counters = True, Counter(damaged_frames=2, incomplete_bytes=3)
    line = progress_line(state)
    assert line == (
        "1.5 s · 10 samples · 8.0 Hz · lost 2 · damaged frames 2 · clipped 1 · 31.2 °C · moving"
    )
    state.waiting = True
    assert "waiting for it" in progress_line(state)
