"""``replay://FILE?speed=1``: a recording, or a raw capture through the parser of the live device.

``speed=1`` is as it was recorded, any multiple of it, and 0 as fast as it can. A file with its
times beside it (``FILE.times``, as ``record --raw`` makes them), or an address that names a
``dialect``, is a capture; anything else is a recording of a known format.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.recording import DeviceInfo, Recording
from drivers.address import Address, parse_address
from drivers.capture import open_capture, times_path
from drivers.driver import Driver
from drivers.formats import open_batches
from drivers.stream import ByteSource, StreamDriver, choose_dialect
from drivers.transports.base import Transport

BATCH = 4096
GATHER = 0.05
"""s of a capture that are handed on at once."""


class Playback:
    """Turns recorded seconds into waiting: ``speed`` recorded seconds a second, 0 is no waiting."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._begin: tuple[float, float] | None = None  # recorded and real time of the first

    def now(self, recorded: float) -> float:
        """Return the recorded time up to which things are due; `recorded` is the next thing's."""
        if not self._speed:
            return np.inf
        real = time.monotonic()
        if self._begin is None:
            self._begin = (recorded, real)
        return self._begin[0] + (real - self._begin[1]) * self._speed

    def wait(self, recorded: float, timeout: float) -> bool:
        """Wait until `recorded` is due, at most `timeout` s; return whether it is."""
        left = recorded - self.now(recorded)
        if left <= 0:
            return True
        time.sleep(min(left / self._speed, timeout))
        return recorded <= self.now(recorded)


class CaptureSource(ByteSource):
    """The bytes of a capture, when they are due."""

    def __init__(self, path: Path, speed: float) -> None:
        self._path = path
        self._speed = speed

    def open(self) -> None:
        """Open the capture."""
        self.ended = False
        self._pieces = open_capture(self._path).pieces()
        self._playback = Playback(self._speed)
        self._next = next(self._pieces, None)

    def close(self) -> None:
        """Nothing is held open between reads but the generator."""
        self._next = None

    def read(self, timeout: float) -> tuple[bytes, float | None]:
        """Return what is due, in pieces of `GATHER` s."""
        if self._next is None:
            self.ended = True
            return b"", None
        first = self._next[1]
        if first is not None and not self._playback.wait(first, timeout):
            return b"", None
        limit = None if first is None else min(first + GATHER, self._playback.now(first))
        parts: list[bytes] = []
        arrival = None
        while self._next is not None and (not parts or _is_due(self._next[1], limit)):
            data, arrival = self._next
            parts.append(data)
            self._next = next(self._pieces, None)
        return b"".join(parts), arrival


def _is_due(arrival: float | None, limit: float | None) -> bool:
    return arrival is not None and limit is not None and arrival <= limit


class RecordingReplay(Driver):
    """A recording as if it were made now; times are those of the file."""

    def __init__(self, address: str, path: Path, *, speed: float, profile: str | None) -> None:
        super().__init__(address)
        self._path = path
        self._speed = speed
        self._profile = profile
        self._info = DeviceInfo()

    @property
    def info(self) -> DeviceInfo:
        """What the file says."""
        return self._info

    def _open(self) -> None:
        self._batches: Iterator[Recording] = open_batches(
            self._path, profile=self._profile, batch=BATCH
        )
        self._playback = Playback(self._speed)
        self._batch: Recording | None = next(self._batches)
        self._info = self._batch.device

    def _close(self) -> None:
        self._batch = None

    def _read(self, timeout: float) -> Recording | None:
        batch = self._batch
        if batch is None:
            self.ended = True
            return None
        gathered = float(batch.time[0]) + GATHER * self._speed
        if not self._playback.wait(min(gathered, float(batch.time[-1])), timeout):
            return None
        due = int(np.searchsorted(batch.time, self._playback.now(float(batch.time[0])), "right"))
        if due >= len(batch):
            self._batch = next(self._batches, None)
            return batch
        self._batch = batch.slice(due, len(batch))
        return batch.slice(0, due)


class Replay(Driver):
    """Looks at the file when it is opened, and then is what the file needs."""

    def __init__(self, address: Address) -> None:
        super().__init__(address.text)
        path, speed = Path(address.target), address.number("speed", 1.0)
        rate = address.number("rate", 0.0) or None
        dialect, options = choose_dialect(address, "speed", "rate")
        source = CaptureSource(path, speed)
        self._path = path
        self._capture = StreamDriver(address.text, source, dialect, options, rate=rate)
        self._recording = RecordingReplay(
            address.text, path, speed=speed, profile=address.options.get("profile")
        )
        self._said = bool(set(address.options) - {"speed", "profile"})
        self._inner: Driver = self._recording

    @property
    def info(self) -> DeviceInfo:
        """What the file says."""
        return self._inner.info

    def _open(self) -> None:
        if self._said or times_path(self._path).is_file():
            stream = open_capture(self._path).stream
            if stream and not self._said:
                self._capture.use(*choose_dialect(parse_address(f"capture://-?{stream}")))
            self._inner = self._capture
        else:
            self._inner = self._recording
        self._inner.open()
        self.counters = self._inner.counters

    def _close(self) -> None:
        self._inner.close()

    def _read(self, timeout: float) -> Recording | None:
        batch = self._inner.read(timeout)
        self.ended = self._inner.ended
        return batch

    def _finish(self) -> Recording | None:
        return self._inner.finish()


TRANSPORT = Transport("replay", "replay://log.arrow?speed=1", Replay)
