"""Recording: limits, losses, reconnects, and what is left when the disk fills up."""

import resource
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.errors import DeviceLostError, DriverTimeoutError, RecordingWriteError
from calib.recording import DeviceInfo, Recording
from drivers import record as module
from drivers.dialects import dialects
from drivers.driver import Driver
from drivers.formats import read_recording
from drivers.record import RecordLimits, RecordState, count_clipped, record
from drivers.stream import StreamDriver
from drivers.transports import make_driver

PtyFactory = Callable[..., Any]


def run(driver: Driver, path: Path, **options: Any) -> RecordState:
    options.setdefault("limits", RecordLimits())
    options.setdefault("stop", threading.Event())
    options.setdefault("progress", lambda state: None)
    return record(
        driver,
        path,
        raw=options.pop("raw", None),
        reconnect=options.pop("reconnect", False),
        **options,
    )


def batch(start: float, count: int = 10, **more: Any) -> Recording:
    generator = np.random.default_rng(int(start * 1000))
    values = generator.normal(size=(2, count, 3))
    return Recording(start + np.arange(count) * 0.01, *values, "device", **more)


class Scripted(Driver):
    """Gives out what it was told to: batches, None, or errors; each list is one connection."""

    def __init__(self, *connections: list[Any]) -> None:
        super().__init__("scripted://")
        self._connections = [list(c) for c in connections]

    @property
    def info(self) -> DeviceInfo:
        return DeviceInfo()

    def _open(self) -> None:
        item = self._connections[0][0]
        if isinstance(item, Exception):
            self._connections.pop(0)
            raise item
        self.counters.clear()

    def _close(self) -> None:
        self._connections.pop(0)

    def _read(self, timeout: float) -> Recording | None:
        script = self._connections[0]
        if not script:
            self.ended = True
            return None
        item = script.pop(0)
        if isinstance(item, Exception):
            raise item
        if callable(item):
            item()
            return None
        return item


@pytest.mark.parametrize("suffix", [".arrow", ".csv"])
def test_samples_and_duration_end_it_exactly(tmp_path: Path, suffix: str) -> None:
    url = "emulator://arduino?speed=0&rate=100"
    state = run(make_driver(url), tmp_path / f"a{suffix}", limits=RecordLimits(samples=777))
    assert (state.samples, state.ended_by) == (777, "samples")
    log = read_recording(tmp_path / f"a{suffix}")
    assert len(log) == 777
    assert log.complete
    state = run(make_driver(url), tmp_path / f"b{suffix}", limits=RecordLimits(duration=12.5))
    assert state.ended_by == "duration"
    assert read_recording(tmp_path / f"b{suffix}").duration == pytest.approx(12.5)
    assert state.rate == pytest.approx(100)


def test_a_raw_capture_replays_to_the_same_recording(tmp_path: Path) -> None:
    driver = make_driver("emulator://vectornav?speed=0&motion=bench")
    run(driver, tmp_path / "a.arrow", limits=RecordLimits(samples=2048), raw=tmp_path / "a.bin")
    state = run(make_driver(f"replay://{tmp_path}/a.bin?speed=0"), tmp_path / "b.arrow")
    assert state.ended_by == "end of the source"
    first, second = read_recording(tmp_path / "a.arrow"), read_recording(tmp_path / "b.arrow")
    assert np.array_equal(first.time, second.time[:2048])
    assert np.array_equal(first.accel, second.accel[:2048])


def test_raw_needs_bytes(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="stream of bytes"):
        run(Scripted([]), tmp_path / "a.arrow", raw=tmp_path / "a.bin")


def test_losses_are_counted_in_the_file(tmp_path: Path) -> None:
    driver = Scripted([batch(0), batch(0.2, lost=np.array([10] + [0] * 9))])
    state = run(driver, tmp_path / "a.arrow")
    assert (state.samples, state.lost, state.any_loss) == (20, 10, True)
    assert read_recording(tmp_path / "a.arrow").samples_lost == 10


def test_stop_saves_what_the_driver_still_held(tmp_path: Path) -> None:
    stop = threading.Event()
    driver = make_driver("emulator://witmotion?rate=100")
    threading.Timer(0.5, stop.set).start()
    state = run(driver, tmp_path / "a.arrow", stop=stop)
    # The host's clock takes a second to settle; half a second of samples is saved all the same.
    assert state.ended_by == "interrupt"
    assert 30 < len(read_recording(tmp_path / "a.arrow")) < 90


def test_a_lost_device_leaves_a_cut_file(tmp_path: Path) -> None:
    driver = Scripted([batch(0), batch(0.1), DeviceLostError("gone")])
    with pytest.raises(DeviceLostError, match=r"gone. The 20 samples before are in .*--reconnect"):
        run(driver, tmp_path / "a.arrow")
    log = read_recording(tmp_path / "a.arrow")
    assert len(log) == 20
    assert not log.complete


def test_reconnect_marks_the_gap(tmp_path: Path) -> None:
    from calib.errors import DeviceNotFoundError

    driver = Scripted(
        [*[batch(0.1 * k) for k in range(5)], DeviceLostError("gone")],
        [DeviceNotFoundError("not yet")],
        [batch(100.0), batch(100.1)],
    )
    seen: list[bool] = []
    state = run(
        driver,
        tmp_path / "a.arrow",
        reconnect=True,
        progress=lambda state: seen.append(state.waiting),
    )
    assert state.reconnects == 1
    assert any(seen)
    log = read_recording(tmp_path / "a.arrow")
    assert log.complete
    assert len(log) == 70
    gap = float(np.diff(log.time)[49])
    assert 0.3 < gap < 3.0  # two attempts, 0.25 s apart
    assert log.lost is not None
    assert log.lost[50] == pytest.approx(gap / 0.01 - 1, abs=2)
    assert log.samples_lost == log.lost[50]


def test_waiting_for_a_device_ends_with_the_duration_or_a_stop(tmp_path: Path) -> None:
    lost = [batch(0), batch(0.1), DeviceLostError("gone")]
    limits = RecordLimits(duration=0.6)
    away = DeviceLostError("still away")
    driver = Scripted(lost, *[[away] for _ in range(20)])
    assert run(driver, tmp_path / "a.arrow", reconnect=True, limits=limits).ended_by == "duration"
    stop = threading.Event()
    driver = Scripted([batch(0), stop.set, DeviceLostError("gone")], [away])
    state = run(driver, tmp_path / "b.arrow", reconnect=True, stop=stop)
    assert state.ended_by == "interrupt"
    assert len(read_recording(tmp_path / "b.arrow")) == 10


def test_a_real_port_that_comes_back(tmp_path: Path, pty_device: PtyFactory) -> None:
    first = pty_device("vectornav", rate=500.0)
    link = tmp_path / "ttyUSB0"
    link.symlink_to(first.path)
    stop = threading.Event()

    def swap() -> None:
        time.sleep(0.4)
        link.unlink()
        first.unplug()
        second = pty_device("vectornav", rate=500.0)
        link.symlink_to(second.path)
        time.sleep(0.8)
        stop.set()

    threading.Thread(target=swap).start()
    driver = make_driver(f"serial://{link}?dialect=vectornav")
    state = run(driver, tmp_path / "a.arrow", reconnect=True, stop=stop)
    assert state.reconnects == 1
    log = read_recording(tmp_path / "a.arrow")
    assert log.complete
    assert log.samples_lost > 0
    assert len(log) > 200


def test_a_silent_device_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SILENCE", 0.05)
    script = [batch(0), *[lambda: time.sleep(0.01)] * 20]
    with pytest.raises(DriverTimeoutError, match="nothing came for"):
        run(Scripted(script), tmp_path / "a.arrow")
    assert len(read_recording(tmp_path / "a.arrow")) == 10


def test_bytes_that_hold_no_samples_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SILENCE", 0.3)
    driver = make_driver("emulator://witmotion")
    assert isinstance(driver, StreamDriver)
    driver.use(dialects()["vectornav"], {})
    with pytest.raises(DriverTimeoutError, match=r"bytes came, 0% of them .* of vectornav"):
        run(driver, tmp_path / "a.arrow")
    assert not (tmp_path / "a.arrow").exists()


@pytest.mark.parametrize("suffix", [".arrow", ".csv"])
def test_a_full_disk(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FLUSH", 0.0)
    path = tmp_path / f"a{suffix}"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
    try:
        with pytest.raises(RecordingWriteError, match="cannot be written any more"):
            run(make_driver("emulator://vectornav?speed=0"), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    log = read_recording(path)
    assert len(log) > 400
    assert np.allclose(np.diff(log.time), 1 / 200)
    assert suffix == ".csv" or not log.complete


def test_the_raw_file_on_a_full_disk(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, hard))
    try:
        with pytest.raises(RecordingWriteError, match=r"raw\.bin cannot be written"):
            run(
                make_driver("emulator://arduino?speed=0"),
                tmp_path / "a.arrow",
                raw=tmp_path / "raw.bin",
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert len(read_recording(tmp_path / "a.arrow")) > 100


def test_clipping_is_counted() -> None:
    device = DeviceInfo(accel_full_scale=20.0, accel_lsb=0.01, gyro_full_scale=4.0)
    values = np.zeros((4, 3))
    accel, gyro = values.copy(), values.copy()
    accel[1, 2], accel[2, 0], gyro[3, 1] = -20.0, 19.99, 3.9
    log = Recording(np.arange(4.0), accel, gyro, "device", device=device)
    assert count_clipped(log) == 2


def test_still_and_moving_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FLUSH", 0.0)
    seen: list[bool | None] = []
    driver = make_driver("emulator://arduino?speed=0&rate=100&motion=bench&seed=1")
    limits = RecordLimits(duration=100.0)
    run(driver, tmp_path / "a.arrow", limits=limits, progress=lambda s: seen.append(s.moving))
    assert {False, True} <= set(seen)
    seen.clear()
    driver = make_driver("emulator://arduino?speed=0&rate=100")
    run(driver, tmp_path / "b.arrow", limits=limits, progress=lambda s: seen.append(s.moving))
    assert seen[-1] is False
