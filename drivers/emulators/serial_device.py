"""Serial devices from the other side of the wire: in this process, or on a pty for any program."""

from __future__ import annotations

import os
import select
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from drivers.address import Address
from drivers.dialects import dialects
from drivers.driver import Driver
from drivers.emulators.base import EmulatedSensor, Emulator, EmulatorOptions, make_sensor
from drivers.stream import ByteSource, StreamDriver

TURN = 0.005
"""s between two looks at the clock."""
GATHER = 0.02
"""s of samples that a reader in this process gets at once."""
BLOCK = 2048
"""Samples at once at most, so that commands are answered while the device catches up."""


class SerialDevice(ABC):
    """A device that streams frames of its sensor and answers commands; no I/O and no clock."""

    def __init__(self, sensor: EmulatedSensor) -> None:
        self.sensor = sensor

    @abstractmethod
    def stream(self, start: int, stop: int) -> bytes:
        """Return the frames of samples ``[start, stop)``."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answer."""
        return b""

    def power_cycle(self) -> None:  # noqa: B027 - a device without memory has nothing to do
        """Switch off and on: what was not saved is forgotten."""


class Pace:
    """How many samples are due: ``rate * speed`` a second; speed 0 is as many as are taken."""

    def __init__(self, rate: float, speed: float) -> None:
        self._rate = rate * speed
        self._begin = time.monotonic()
        self.sent = 0

    def due(self) -> int:
        """Return how many samples to send now, at most `BLOCK`."""
        if not self._rate:
            return BLOCK
        late = int((time.monotonic() - self._begin) * self._rate) - self.sent
        return min(max(late, 0), BLOCK)

    def skip(self) -> None:
        """Forget the samples that nobody was there to take."""
        self.sent += self.due() if self._rate else 0


class EmulatedSource(ByteSource):
    """A serial device inside this process. Arrivals are in the device's time, without jitter."""

    def __init__(self, device: Callable[[], SerialDevice], speed: float) -> None:
        self._make = device
        self._speed = speed
        self._device: SerialDevice | None = None
        self._answers = b""

    @property
    def device(self) -> SerialDevice:
        """The emulated device; made when it is first needed, and kept over open and close."""
        if self._device is None:
            self._device = self._make()
        return self._device

    def open(self) -> None:
        """Start the stream."""
        self._pace = Pace(self.device.sensor.rate, self._speed)
        self._answers = b""

    def close(self) -> None:
        """Stop the stream."""

    def read(self, timeout: float) -> tuple[bytes, float | None]:
        """Return the frames that are due."""
        deadline = time.monotonic() + timeout
        pace, rate = self._pace, self.device.sensor.rate
        while not (due := pace.due()) and not self._answers:
            if time.monotonic() >= deadline:
                return b"", None
            time.sleep(GATHER)
        data = self.device.stream(pace.sent, pace.sent + due) if due else b""
        data += self._answers
        pace.sent += due
        self._answers = b""
        return data, pace.sent / rate

    def write(self, data: bytes) -> None:
        """Hand a command to the device."""
        self._answers += self.device.receive(data)


def serve_on_pty(
    device: SerialDevice,
    *,
    speed: float,
    announce: Callable[[str], None],
    stop: threading.Event,
) -> None:
    """Put a device on a new pty and call `announce` with the pty's path; run until `stop` is set.

    While no program has the pty open the device talks to nobody, as a real one does. What a reader
    does not take holds the device up (a pty has flow control): nothing is dropped on the way.
    """
    import tty

    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        path = os.ttyname(slave)
        os.set_blocking(master, False)
        os.close(slave)
        _run(device, master, speed, stop, lambda: announce(path))
    finally:
        os.close(master)


def _run(
    device: SerialDevice,
    master: int,
    speed: float,
    stop: threading.Event,
    ready: Callable[[], None],
) -> None:
    poll = select.poll()
    poll.register(master, select.POLLIN | select.POLLOUT)
    pace = Pace(device.sensor.rate, speed)
    pending = b""
    ready()
    while not stop.is_set():
        events = dict(poll.poll(100)).get(master, 0)
        if events & select.POLLHUP:  # nobody listens
            pace.skip()
            pending = b""
            stop.wait(TURN)
            continue
        try:
            if events & select.POLLIN:
                pending += device.receive(os.read(master, 4096))
            if not pending and (due := pace.due()):
                pending = device.stream(pace.sent, pace.sent + due)
                pace.sent += due
            if pending and events & select.POLLOUT:
                pending = pending[os.write(master, pending) :]
        except BlockingIOError:
            stop.wait(0.0002)
        except OSError:
            continue  # the reader went away meanwhile
        if not pending:
            stop.wait(TURN)


def serial_emulator(
    name: str,
    summary: str,
    make: Callable[[EmulatedSensor], SerialDevice],
    *,
    default_rate: float,
    dialect: str | None = None,
    options: str = "",
) -> Emulator:
    """Return the `Emulator` of a serial device that speaks `dialect` (its own name if None).

    `options` are what a reader's address must say besides the dialect, as in ``&columns=...``.
    """
    dialect = dialect or name

    def device(chosen: EmulatorOptions) -> SerialDevice:
        return make(make_sensor(chosen, default_rate=default_rate))

    def driver(address: Address) -> Driver:
        chosen = EmulatorOptions.from_address(address)
        source = EmulatedSource(lambda: device(chosen), chosen.speed)
        words = dict(pair.split("=", 1) for pair in options.split("&") if pair)
        return StreamDriver(address.text, source, dialects()[dialect], words)

    def serve(
        chosen: EmulatorOptions, announce: Callable[[str], None], stop: threading.Event
    ) -> None:
        serve_on_pty(
            device(chosen),
            speed=chosen.speed,
            announce=lambda path: announce(f"serial://{path}?dialect={dialect}{options}"),
            stop=stop,
        )

    return Emulator(name, summary, driver, serve)
