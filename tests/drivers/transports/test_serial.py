"""Through a real kernel tty: a pty with an emulated device on the other side."""

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calib.errors import (
    AddressError,
    BadFrameError,
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    DevicePermissionError,
    DriverTimeoutError,
    WrongDeviceError,
)
from calib.recording import Recording
from drivers import stream
from drivers.dialects.witmotion import UNLOCK, read_register, write_register
from drivers.driver import Driver
from drivers.emulators.base import EmulatorOptions, make_sensor
from drivers.stream import StreamDriver
from drivers.transports import make_driver, open_driver, serial

PtyFactory = Callable[..., Any]


def gather(driver: Driver, count: int, timeout: float = 10.0) -> list[Recording]:
    batches: list[Recording] = []
    deadline = time.monotonic() + timeout
    while sum(map(len, batches)) < count:
        assert time.monotonic() < deadline
        batch = driver.read(0.2)
        if batch is not None:
            batches.append(batch)
    return batches


@pytest.mark.parametrize("name", ["arduino", "vectornav", "px4"])
def test_samples_come_as_the_sensor_measured_them(pty_device: PtyFactory, name: str) -> None:
    device = pty_device(name, rate=500.0, seed=3, speed=4.0)
    with open_driver(device.address) as driver:
        batches = gather(driver, 1000)
        accel = np.concatenate([b.accel for b in batches])
        time_ = np.concatenate([b.time for b in batches])
    assert batches[0].clock == "device"
    assert np.allclose(np.diff(time_), 0.002, atol=2e-6)
    assert sum(b.samples_lost for b in batches) == 0
    assert not set(driver.counters) - {"incomplete_bytes"}
    # The device ran before we came; find our first sample in what it measured.
    true, _ = make_sensor(EmulatorOptions(rate=500.0, seed=3), default_rate=1.0).measure(0, 6000)
    start = int(np.argmin(np.abs(true.accel[:4000] - accel[0]).sum(axis=1)))
    assert np.allclose(accel, true.accel[start : start + len(accel)], atol=1e-4)


def test_a_device_without_clock_is_timed_by_the_host(pty_device: PtyFactory) -> None:
    device = pty_device("witmotion", rate=1000.0)
    with open_driver(device.address.replace("witmotion", "auto")) as driver:
        batches = gather(driver, 1500)
        time_ = np.concatenate([b.time for b in batches])
        assert batches[0].clock == "host"
        assert driver.info.rate == pytest.approx(1000, rel=0.02)
    assert np.diff(time_).min() > 0
    assert np.std(np.diff(time_)) < 2e-4


def test_commands_are_answered_while_samples_flow(pty_device: PtyFactory) -> None:
    device = pty_device("witmotion", rate=500.0)
    with open_driver(device.address) as driver:
        assert isinstance(driver, StreamDriver)
        driver.send(write_register(5, 1234))
        assert driver.ask(read_register(5), "registers", 2.0).values == (0, 0, 0, 0)  # locked
        driver.send(UNLOCK)
        driver.send(write_register(5, -1234))
        assert driver.ask(read_register(5), "registers", 2.0).values == (-1234, 0, 0, 0)
        with pytest.raises(DriverTimeoutError, match="no answer nonsense"):
            driver.ask(b"", "nonsense", 0.05)
        assert sum(b.samples_lost for b in gather(driver, 300)) == 0


def test_text_lines_are_recognised_and_shown(pty_device: PtyFactory) -> None:
    device = pty_device("arduino", rate=500.0)
    with pytest.raises(AddressError, match=r"columns=t,ax.*A line from it: \d+,-?\d+\.\d{4},"):
        open_driver(f"serial://{device.path}")


def test_a_port_is_locked_and_says_by_whom(pty_device: PtyFactory) -> None:
    device = pty_device("vectornav")
    user = rf"pid {os.getpid()} \(.*python"
    with open_driver(device.address), pytest.raises(DeviceBusyError, match=user):
        open_driver(device.address)
    open_driver(device.address).close()


def test_an_unplugged_device_is_lost_after_its_last_sample(pty_device: PtyFactory) -> None:
    device = pty_device("vectornav", rate=500.0)
    with open_driver(device.address) as driver:
        gather(driver, 50)
        device.unplug()
        with pytest.raises(DeviceLostError, match="went away"):
            gather(driver, 10**9)
        with pytest.raises(DeviceLostError):
            driver.send(b"x" * 10)  # type: ignore[attr-defined]
    driver.close()


def test_ports_that_cannot_be_opened(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceNotFoundError, match="Ports that exist"):
        open_driver("serial:///dev/ttyNOT0")
    plain = tmp_path / "file"
    plain.write_bytes(b"")
    with pytest.raises(WrongDeviceError, match="cannot be used as a serial port"):
        open_driver(f"serial://{plain}")

    def refuse(*_: object, **__: object) -> None:
        raise serial.serial.SerialException(13, "could not open port: Permission denied")

    monkeypatch.setattr(serial.serial, "Serial", refuse)
    with pytest.raises(DevicePermissionError, match="usermod -aG"):
        open_driver(f"serial://{plain}")


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("serial:///dev/x?dialect=nmea", "can be auto, mavlink, text, vectornav, witmotion"),
        ("serial:///dev/x?dialect=witmotion&columns=t", "unknown option 'columns'"),
        ("serial:///dev/x?baud=fast", "baud=fast is not a whole number"),
        ("serial:///dev/x?columns=t,ax", "lacks ay"),
        ("serial:///dev/x?rate=100", "unknown option 'rate'"),
    ],
)
def test_addresses_are_checked_before_any_io(url: str, says: str) -> None:
    with pytest.raises(AddressError, match=says):
        make_driver(url)


def test_silence_and_noise_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "SILENCE", 0.2)
    monkeypatch.setattr(stream, "LISTEN", 0.2)
    master, slave = os.openpty()
    try:
        path = os.ttyname(slave)
        with pytest.raises(DriverTimeoutError, match="not a byte came"):
            open_driver(f"serial://{path}")
        stop = threading.Event()

        def chatter() -> None:
            while not stop.wait(0.01):
                os.write(master, bytes(range(128, 250)))

        thread = threading.Thread(target=chatter)
        thread.start()
        try:
            with pytest.raises(BadFrameError, match="try baud="):
                open_driver(f"serial://{path}")
        finally:
            stop.set()
            thread.join()
    finally:
        os.close(master)
        os.close(slave)


def test_a_device_is_found_again_by_its_usb_identity(
    pty_device: PtyFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = pty_device("vectornav", rate=500.0), pty_device("vectornav", rate=500.0)
    there = [serial.SerialPort(first.path, "IMU", 0x10C4, 0xEA60, "A1")]
    monkeypatch.setattr(serial, "list_serial_ports", lambda: list(there))
    driver = open_driver(first.address)
    gather(driver, 10)
    first.unplug()
    driver.close()
    there[:] = [
        serial.SerialPort("/dev/other", "IMU", 0x10C4, 0xEA60, "B2"),
        serial.SerialPort(second.path, "IMU", 0x10C4, 0xEA60, "A1"),
    ]
    driver.open()
    assert gather(driver, 10)
    driver.close()
    there[:] = []


def test_reads_need_an_open_driver() -> None:
    driver = make_driver("serial:///dev/ttyNOT0?dialect=witmotion")
    with pytest.raises(ValueError, match="is not open"):
        driver.read(0.1)
    assert driver.finish() is None
