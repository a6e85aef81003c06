import time
from pathlib import Path

import numpy as np
import pytest

from calib.errors import RecordingFormatError, RecordingNotFoundError, UnitError
from calib.recording import Recording, join
from drivers.capture import CaptureWriter, open_capture
from drivers.driver import Driver
from drivers.emulators.arduino import ArduinoSketch
from drivers.emulators.base import EmulatorOptions, make_sensor
from drivers.emulators.witmotion import WitMotionDevice
from drivers.formats import write_recording
from drivers.transports import make_driver, open_driver

RATE = 100.0


def sensor(seed: int = 2):  # type: ignore[no-untyped-def]
    return make_sensor(EmulatorOptions(rate=RATE, seed=seed), default_rate=RATE)


def recording(count: int = 200) -> Recording:
    signals, temperature = sensor().measure(0, count)
    return Recording(
        np.arange(count) / RATE + 5.0, signals.accel, signals.gyro, "device", temperature
    )


def everything(driver: Driver) -> Recording:
    parts = []
    with driver:
        while not driver.ended:
            part = driver.read(0.5)
            if part is not None:
                parts.append(part)
    return join(parts)


def capture(path: Path, device: str, *, stream: str) -> None:
    made = {"witmotion": WitMotionDevice, "arduino": ArduinoSketch}[device](sensor())
    with CaptureWriter(path, "serial:///dev/ttyUSB0", lambda: stream) as writer:
        for start in range(0, 300, 5):
            writer.add(made.stream(start, start + 5), 100.0 + (start + 5) / RATE)


@pytest.mark.parametrize("suffix", [".arrow", ".csv"])
def test_a_recording_comes_back_as_it_is(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    write_recording(recording(), path)
    back = everything(make_driver(f"replay://{path}?speed=0"))
    assert np.array_equal(back.time, recording().time)
    assert np.array_equal(back.accel, recording().accel)
    assert back.clock == "device"


@pytest.mark.parametrize("kind", ["recording", "capture"])
def test_speed_is_a_multiple_of_the_recorded(tmp_path: Path, kind: str) -> None:
    if kind == "recording":
        path = tmp_path / "log.arrow"
        write_recording(recording(300), path)
    else:
        path = tmp_path / "bytes.bin"
        capture(path, "witmotion", stream="dialect=witmotion")
    begin = time.monotonic()
    back = everything(make_driver(f"replay://{path}?speed=6"))
    assert len(back) == 300
    assert 0.4 < time.monotonic() - begin < 3.0


def test_a_capture_goes_through_the_live_parser(tmp_path: Path) -> None:
    path = tmp_path / "bytes.bin"
    capture(path, "witmotion", stream="dialect=witmotion")
    back = everything(make_driver(f"replay://{path}?speed=0"))
    assert len(back) == 300
    assert back.clock == "host"
    assert np.allclose(np.diff(back.time), 1 / RATE, rtol=1e-6)
    again = everything(make_driver(f"replay://{path}?speed=0&dialect=auto"))
    assert np.array_equal(again.accel, back.accel)


def test_bytes_without_times_need_the_rate(tmp_path: Path) -> None:
    path = tmp_path / "bytes.bin"
    path.write_bytes(WitMotionDevice(sensor()).stream(0, 50))
    with pytest.raises(UnitError, match="rate="):
        everything(make_driver(f"replay://{path}?dialect=witmotion"))
    back = everything(make_driver(f"replay://{path}?dialect=witmotion&rate=100"))
    assert back.clock == "nominal"
    assert np.allclose(back.time, np.arange(50) / RATE)


def test_bytes_without_times_but_with_a_device_clock(tmp_path: Path) -> None:
    path = tmp_path / "bytes.txt"
    path.write_bytes(ArduinoSketch(sensor()).stream(0, 50))
    url = f"replay://{path}?columns=t,ax,ay,az,gx,gy,gz,temp&time_unit=us"
    back = everything(make_driver(f"{url}&accel_unit=m/s^2&gyro_unit=rad/s"))
    assert back.clock == "device"
    assert len(back) == 49  # the first line may have been cut
    assert np.allclose(np.diff(back.time), 1 / RATE)


def test_files_that_cannot_be_played(tmp_path: Path) -> None:
    with pytest.raises(RecordingNotFoundError):
        open_driver(f"replay://{tmp_path}/none.arrow")
    with pytest.raises(RecordingNotFoundError):
        open_driver(f"replay://{tmp_path}/none.bin?dialect=witmotion")
    path = tmp_path / "bytes.bin"
    path.write_bytes(b"abc")
    times = tmp_path / "bytes.bin.times"
    for text in ("hello\n", "# imu-cal capture 1\nabc\n", "# imu-cal capture 1\n0 3\n1 2\n"):
        times.write_text(text)
        with pytest.raises(RecordingFormatError):
            open_driver(f"replay://{path}")


def test_a_cut_capture_is_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "bytes.bin"
    capture(path, "arduino", stream="dialect=text")
    data, times = path.read_bytes(), tmp_path / "bytes.bin.times"
    path.write_bytes(data[:-100])
    times.write_text(times.read_text()[:-7])
    pieces = list(open_capture(path).pieces())
    assert b"".join(piece for piece, _ in pieces) == data[:-100]
    assert all(arrival is not None for _, arrival in pieces)
