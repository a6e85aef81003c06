"""Samples from a stream of bytes: a serial port, a capture or an emulator, through one parser."""

from __future__ import annotations

import time as clock
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from urllib.parse import urlencode

from calib.errors import AddressError, BadFrameError, DriverTimeoutError
from calib.recording import DeviceInfo, Recording
from drivers.address import Address
from drivers.clock import Timeline
from drivers.dialects import dialects, recognise
from drivers.dialects.base import Dialect, Parser, Reply
from drivers.driver import Driver

LISTEN = 1.0
"""s of bytes that ``dialect=auto`` is recognised from."""
PLENTY = 1 << 16
"""Bytes that are enough to recognise a dialect from, however fast they come."""
SILENCE = 3.0
"""s to wait for a device's first byte before saying that it is silent."""


class ByteSource(ABC):
    """Where a stream's bytes come from. The constructor does no I/O."""

    ended = False

    @abstractmethod
    def open(self) -> None:
        """Connect; raise a `DriverError` that says what is in the way."""

    @abstractmethod
    def close(self) -> None:
        """Let go. Closing twice is harmless."""

    @abstractmethod
    def read(self, timeout: float) -> tuple[bytes, float | None]:
        """Return the bytes that are waiting and when the last of them arrived, s.

        The arrival is None where nobody noted it. No bytes means that none came in time, or, with
        `ended`, that none ever will.
        """

    def write(self, data: bytes) -> None:
        """Send bytes to the device."""
        raise BadFrameError("this source of bytes cannot be written to")


class StreamDriver(Driver):
    """A `ByteSource`, a dialect and a clock.

    Parameters
    ----------
    address : str
    source : ByteSource
    dialect : Dialect or None
        None recognises it from the first second of bytes.
    options : mapping
        The dialect's own options.
    rate : float, Hz, or None
        The nominal rate, for bytes whose arrival nobody noted.
    """

    def __init__(
        self,
        address: str,
        source: ByteSource,
        dialect: Dialect | None,
        options: Mapping[str, str],
        *,
        rate: float | None = None,
    ) -> None:
        super().__init__(address)
        self.source = source
        self.tap: Callable[[bytes, float | None], None] | None = None
        """Called with all bytes and their arrival, for a raw capture."""
        self._rate = rate
        self._parser: Parser | None = None
        self._timeline: Timeline | None = None
        self._clock_counters: Counter[str] = Counter()
        self.use(dialect, options)

    def use(self, dialect: Dialect | None, options: Mapping[str, str]) -> None:
        """Read this dialect from now on; a wrong option fails before any I/O.

        Raises
        ------
        AddressError
            If an option has a value that is not understood.
        """
        self.dialect = dialect
        self._options = options
        if dialect is not None:
            self._parser = dialect.parser(options)

    def describe_stream(self) -> str:
        """Return ``dialect=...&option=...``, by which the same bytes can be read again."""
        assert self.dialect is not None
        return urlencode({"dialect": self.dialect.name, **self._options})

    @property
    def info(self) -> DeviceInfo:
        """The dialect's facts, and the rate once it is known."""
        info = self._parser.info if self._parser is not None else DeviceInfo()
        if self._timeline is None or not self._timeline.interval or info.rate is not None:
            return info
        return replace(info, rate=1.0 / self._timeline.interval)

    def _open(self) -> None:
        self.counters.clear()
        self._clock_counters.clear()
        self._bytes = 0
        self._timeline = None
        self.source.open()
        try:
            if self.dialect is None:
                self._recognise()
            else:
                self._start(self.dialect)
        except BaseException:
            self.source.close()
            raise

    def _start(self, dialect: Dialect) -> None:
        self._parser = dialect.parser(self._options)
        self._timeline = Timeline(
            period=self._parser.clock_period,
            rate=self._rate,
            counters=self._clock_counters,
        )

    def _close(self) -> None:
        self.source.close()

    def _recognise(self) -> None:
        """Listen for `LISTEN` s, then take the dialect that explains the bytes."""
        heard: list[tuple[bytes, float | None]] = []
        deadline, size = clock.monotonic() + SILENCE, 0
        while (left := deadline - clock.monotonic()) > 0 and not self.source.ended:
            data, arrival = self.source.read(min(left, 0.1))
            if not data:
                continue
            if not heard:
                deadline = clock.monotonic() + LISTEN
            heard.append((data, arrival))
            size += len(data)
            begin = heard[0][1]
            if size >= PLENTY or (arrival and begin and arrival - begin >= LISTEN):
                break  # a replay may be faster than our clock
        if not heard:
            raise DriverTimeoutError(
                f"{self.address}: open, but not a byte came in {SILENCE:g} s. Check the wiring "
                "(the device's TX to our RX), its power, and whether it must be told to start"
            )
        together = b"".join(data for data, _ in heard)
        dialect = recognise(together)
        try:
            self._start(dialect)
        except AddressError as error:  # recognised, but its options are needed
            line = together.split(b"\n")[-2:-1] or [together]
            shown = line[0][:100].decode("ascii", "replace").strip()
            raise AddressError(f"{self.address}: {error}. A line from it: {shown}") from error
        self.dialect = dialect
        for data, arrival in heard:
            self._take(data, arrival)

    def _read(self, timeout: float) -> Recording | None:
        deadline = clock.monotonic() + timeout
        while True:
            if (batch := self._emit()) is not None:
                return batch
            data, arrival = self.source.read(max(deadline - clock.monotonic(), 0.0))
            if data:
                self._take(data, arrival)
            elif self.source.ended:
                batch = self._finish()
                self.ended = True
                return batch
            if clock.monotonic() >= deadline:
                return self._emit()

    def _finish(self) -> Recording | None:
        assert self._parser is not None
        self._parser.finish()
        return self._emit(final=True)

    def why_silent(self) -> str:
        """Return whether bytes come, and what they are if not samples."""
        if not self._bytes or self._parser is None or self.dialect is None:
            return super().why_silent()
        share = self._parser.accepted_bytes / self._bytes
        return (
            f"{self._bytes} bytes came, {share:.0%} of them frames or lines of "
            f"{self.dialect.name}. Is this the right dialect and baud rate, and does the device "
            "send both acceleration and rate?"
        )

    def ask(self, request: bytes, key: str, timeout: float) -> Reply:
        """Send a command and return the answer with that key; samples meanwhile are kept.

        Raises
        ------
        DriverTimeoutError
            If no such answer came in time.
        """
        assert self._parser is not None
        self._parser.replies.clear()
        self.source.write(request)
        deadline = clock.monotonic() + timeout
        while (left := deadline - clock.monotonic()) > 0 and not self.source.ended:
            data, arrival = self.source.read(left)
            if data:
                self._take(data, arrival)
            for reply in self._parser.replies:
                if reply.key == key:
                    return reply
        raise DriverTimeoutError(f"{self.address}: no answer {key} to {request!r} in {timeout:g} s")

    def send(self, data: bytes) -> None:
        """Send a command that is not answered."""
        self.source.write(data)

    def _take(self, data: bytes, arrival: float | None) -> None:
        assert self._parser is not None
        assert self._timeline is not None
        self._bytes += len(data)
        if self.tap is not None:
            self.tap(data, arrival)
        self._timeline.add(self._parser.feed(data), arrival)

    def _emit(self, *, final: bool = False) -> Recording | None:
        assert self._parser is not None
        assert self._timeline is not None
        placed = self._timeline.take(final=final)
        self.counters.clear()
        self.counters.update(self._parser.counters + self._clock_counters)
        if placed is None:
            return None
        time, samples = placed
        return Recording(
            time=time,
            accel=samples.accel,
            gyro=samples.gyro,
            clock=self._timeline.clock,
            temperature=samples.temperature,
            lost=samples.lost,
            device=self.info,
            notes={"source": self.address},
        )


def choose_dialect(address: Address, *more: str) -> tuple[Dialect | None, dict[str, str]]:
    """Return the dialect that an address names and its own options; `more` are other known keys.

    None is ``dialect=auto``, the default. Options that only text lines have imply ``text``.

    Raises
    ------
    AddressError
        If the dialect or an option is unknown.
    """
    known = dialects()
    text = set(known["text"].options)
    implied = "text" if text & set(address.options) else "auto"
    name = address.choice("dialect", ["auto", *known], implied)
    dialect = None if name == "auto" else known[name]
    own = set(dialect.options) if dialect else set()
    address.check({"dialect", *own, *more} if dialect else {"dialect", *text, *more})
    return dialect, {key: value for key, value in address.options.items() if key in own}
