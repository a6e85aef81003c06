"""The guided session: what it asks for, what it warns of, when it ends, and how it resumes."""

import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from fcntl import ioctl
from pathlib import Path
from termios import TIOCSWINSZ

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from calib.calibration import Gravity
from calib.model import SensorModel, Triad
from calib.planning import Action
from calib.recording import DeviceInfo, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses
from drivers.formats import read_recording, write_recording
from drivers.transports import make_driver
from imu_cli.app import app
from imu_cli.bench.run import load_earlier, run_session, slices
from imu_cli.bench.screen import Header, render
from imu_cli.bench.session import Session, Status
from imu_cli.bench.targets import make_targets
from imu_cli.bench.words import describe_pose, instruction

URL = "emulator://witmotion?motion=bench&speed=0&seed=3"
GRAVITY = Gravity(9.80665)
ROOT = Path(__file__).resolve().parents[3]


def a_recording(model: SensorModel, *, seed: int = 3, poses: int = 8) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=poses, mixed=0.0, warm_up=0.0)
    return simulate(motion, model, CONSUMER, rng=rng, rate=100.0)


def fed(recording: Recording) -> tuple[Session, Status]:
    session = Session(targets=make_targets(()), gravity=GRAVITY)
    status = session.status()
    for part in slices(recording, width=4.0):
        session.add(part)
        status = session.status()
    return session, status


def test_targets_are_read_and_the_more_exact_name_wins() -> None:
    targets = make_targets(["accel.bias=2 mg", "accel.bias.z=3 mg"])
    assert targets["accel.bias.x"] == pytest.approx(2e-3 * 9.80665)
    assert targets["accel.bias.z"] == pytest.approx(3e-3 * 9.80665)
    for wrong in ("accel.bais=2 mg", "accel.bias", "accel.bias=2 dps", "accel.bias=-1 mg"):
        with pytest.raises(ValueError, match=r"target|units"):
            make_targets([wrong])


@pytest.mark.parametrize(
    ("up", "words"),
    [
        ((0, 0, 1), "the -Z face is down"),
        ((0, -1, 0), "the +Y face is down"),
        ((1, 1, 0), "the edge of -X and -Y"),
        ((-1, -1, -1), "the corner of +X, +Y and +Z"),
    ],
)
def test_poses_are_said_by_the_face_that_is_down(up: tuple[int, int, int], words: str) -> None:
    assert words in describe_pose(np.array(up) / np.linalg.norm(up))


def test_an_instruction_says_axis_angle_and_end() -> None:
    text = instruction(Action(np.array([1.0, 0, 0]), -np.pi / 2, np.array([0.0, 1.0, 0])))
    assert "by 90° about its -X axis" in text
    assert "-Y face is down" in text


def test_every_parameter_is_shown_and_errors_fall() -> None:
    recording = a_recording(SensorModel(), poses=16)
    session = Session(targets=make_targets(()), gravity=GRAVITY)
    seen = []
    for part in slices(recording, width=4.0):
        session.add(part)
        seen.append(session.status())
        if part.time[-1] < recording.time[-1] / 2:
            assert session.fixed_routine_time() is None
    early, status = seen[len(seen) // 2 - 1], seen[-1]
    assert len([e for e in status.errors.values() if e is not None]) == 21
    for name, error in status.errors.items():
        before = early.errors[name]
        assert before is None or error is None or error < 1.6 * before


@pytest.mark.long
def test_swapped_axes_are_warned_of() -> None:
    good = a_recording(SensorModel())
    swapped = Recording(good.time, good.accel, good.gyro[:, [1, 0, 2]], "device")
    assert any("axes are swapped" in w for w in fed(swapped)[1].warnings)
    assert not any("axes" in w for w in fed(good)[1].warnings)


def test_a_wrong_full_scale_is_warned_of() -> None:
    good = a_recording(SensorModel())
    wrong = Recording(good.time, good.accel * 2, good.gyro, "device")
    assert any("full scale" in w for w in fed(wrong)[1].warnings)


def test_clipping_is_warned_of() -> None:
    good = a_recording(SensorModel())
    limit = 0.5 * float(np.abs(good.gyro[:, 2]).max())
    clipped = Recording(
        good.time,
        good.accel,
        np.clip(good.gyro, -limit, limit),
        "device",
        device=DeviceInfo(gyro_full_scale=limit),
    )
    session = Session(targets=make_targets(()), gravity=GRAVITY)
    said: list[str] = []
    for part in slices(clipped, width=2.0):
        session.add(part)
        said += session.status().warnings
    assert any("reached full scale" in w for w in said)


def test_a_turn_about_the_vertical_is_warned_of() -> None:
    clock = np.arange(0, 12, 0.01)
    rng = np.random.default_rng(0)
    accel = np.array([0, 0, 9.80665]) + rng.normal(0, 0.02, (len(clock), 3))
    gyro = rng.normal(0, 1e-3, (len(clock), 3))
    gyro[(clock > 5) & (clock < 7), 2] += np.pi / 4
    warnings = fed(Recording(clock, accel, gyro, "device"))[1].warnings
    assert any("about the vertical" in w for w in warnings)


@pytest.mark.long
def test_a_bumped_pose_is_told_and_asked_for_again() -> None:
    good = a_recording(SensorModel(), poses=14)
    poses = find_poses(good)
    accel = good.accel.copy()
    accel[poses.start[10] - 20 : poses.stop[10] + 20, 0] += 0.3  # 30 mg: leaning on the table
    asked = []
    session = Session(targets=make_targets(()), gravity=GRAVITY)
    for part in slices(Recording(good.time, accel, good.gyro, "device"), width=2.0):
        session.add(part)
        asked.append(session.status().repeat)
    assert any("does not count" in text for text in asked)
    assert not fed(good)[1].repeat


def test_a_warming_sensor_is_warned_of() -> None:
    good = a_recording(SensorModel())
    temperature = 25 + 0.1 * good.time
    warming = Recording(good.time, good.accel, good.gyro, "device", temperature=temperature)
    assert any("warming" in w for w in fed(warming)[1].warnings)


def test_the_screen_fits_a_terminal_of_eighty_columns() -> None:
    _, status = fed(a_recording(SensorModel(Triad(bias=np.array([0.3, 0, 0])))))
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        console = Console(width=80, height=30, record=True, file=nowhere)
        console.print(render(status, Header("emulator://x", "MPU-6050", 100.0, 2, 31.0)))
    text = console.export_text()
    assert all(len(line) <= 80 for line in text.splitlines())
    for part in ("Turn it by", "2 lost", "gyro misalign", "turned", "●"):
        assert part in text


@pytest.mark.long
def test_a_session_that_was_stopped_is_taken_up_and_ends_by_itself(tmp_path: Path) -> None:
    path = tmp_path / "bench.arrow"
    stop = threading.Event()

    def show(status: Status, header: Header) -> None:
        if header.elapsed > 20:
            stop.set()

    session = Session(targets=make_targets(()), gravity=GRAVITY)
    driver = make_driver(URL.replace("speed=0", "speed=40"))
    first = run_session(session, driver, path, earlier=None, stop=stop, show=show)
    assert first.ended == "interrupted"
    earlier = load_earlier(path)
    assert earlier is not None
    assert not earlier.complete
    second = run_session(
        Session(targets=make_targets(()), gravity=GRAVITY),
        make_driver(URL),
        path,
        earlier=earlier,
        stop=threading.Event(),
        show=lambda status, header: None,
    )
    assert second.ended == "done"
    whole = read_recording(path)
    assert whole.complete
    np.testing.assert_array_equal(whole.accel[: len(earlier)], earlier.accel)
    assert whole.samples_lost >= 1
    for name, error in second.status.errors.items():
        assert error is not None
        assert error <= second.status.targets[name]


@pytest.mark.long
def test_auto_on_a_replay_writes_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(a_recording(SensorModel(), poses=20), tmp_path / "log.arrow")
    command = ["bench", "replay://log.arrow?speed=0", "--auto"]
    done = CliRunner().invoke(app, [*command, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["targets_met"]
    assert result["six_face_routine_seconds"] is None
    for name in ("recording", "calibration", "report"):
        assert (tmp_path / result["files"][name]).stat().st_size > 0
    again = CliRunner().invoke(app, command, catch_exceptions=False)
    assert again.exit_code == 3
    assert "finished recording" in again.stderr


@pytest.mark.parametrize("suffix", [".arrow", ".csv"])
def test_a_full_disk_is_said(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.symlink_to("/dev/full")
    url = "emulator://witmotion?motion=bench&speed=0&seed=3"
    done = CliRunner().invoke(app, ["bench", url, "-o", str(path), "--auto", "--overwrite"])
    assert done.exit_code == 3
    assert "cannot be written any more" in " ".join(done.stderr.split())
    assert "No space left" in " ".join(done.stderr.split())


def test_a_terminal_shows_the_screen_and_ctrl_c_pauses(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    ioctl(slave, TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-m", "imu_cli", "bench", URL.replace("speed=0", "speed=10"), "--auto"],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color"},
    )
    os.close(slave)
    seen = b""
    end = time.monotonic() + 60
    interrupted = False
    while process.poll() is None and time.monotonic() < end:
        if select.select([master], [], [], 0.2)[0]:
            try:
                seen += os.read(master, 65536)
            except OSError:
                break
        if not interrupted and b"Turn it by" in seen:
            process.send_signal(signal.SIGINT)
            interrupted = True
    assert process.wait(timeout=30) == 130
    os.close(master)
    text = seen.decode(errors="replace")
    assert "Turn it by" in text
    assert "imu-cal bench" in text
    assert not read_recording(tmp_path / "bench.arrow").complete
