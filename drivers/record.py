"""Recording: from a driver to a file that stays readable whatever happens to us."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType

import numpy as np

from calib.errors import (
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    DevicePermissionError,
    DriverTimeoutError,
    RecordingWriteError,
)
from calib.live_statics import LiveStatics
from calib.recording import DeviceInfo, Recording, join
from drivers.capture import CaptureWriter
from drivers.driver import Driver
from drivers.formats import open_writer
from drivers.stream import StreamDriver

FLUSH = 0.5
"""s between writes to the disk: what a kill can lose at most, with one such period in hand."""
POLL = 0.2
"""s that one read may wait, so that a stop is obeyed at once."""
SILENCE = 10.0
"""s without a sample before a device counts as silent."""
RETRY = 0.25
"""s between attempts to find a vanished device."""
HARMLESS = {"incomplete_bytes", "other_lines", "samples_without_unit"}
"""Counters that are no loss: the half line in which we came and went, text for people, and what
came before the device said what its unit is."""
AWAY = (DeviceNotFoundError, DeviceLostError, DeviceBusyError, DevicePermissionError)
"""What opening a device raises while it is away or just coming back."""


@dataclass
class RecordState:
    """How a recording stands; `record` updates it and hands it to the progress callback."""

    samples: int = 0
    lost: int = 0
    duration: float = 0.0
    rate: float = 0.0
    clipped: int = 0
    temperature: float | None = None
    moving: bool | None = None
    reconnects: int = 0
    waiting: bool = False
    clock: str = ""
    ended_by: str = ""
    device: DeviceInfo = field(default_factory=DeviceInfo)
    counters: Counter[str] = field(default_factory=Counter)

    @property
    def any_loss(self) -> bool:
        """Whether anything at all went missing or was damaged."""
        return bool(self.lost or set(self.counters) - HARMLESS)


@dataclass(frozen=True)
class RecordLimits:
    """When to stop: after `duration` s of recording time or `samples`; None is never."""

    duration: float | None = None
    samples: int | None = None


def record(
    driver: Driver,
    path: Path,
    *,
    limits: RecordLimits,
    raw: Path | None,
    reconnect: bool,
    stop: threading.Event,
    progress: Callable[[RecordState], None],
) -> RecordState:
    """Record until a limit, the end of the source, or `stop`; everything received is saved.

    The file is handed to the disk every half second. A device that goes away ends the recording,
    which then counts as cut, or with `reconnect` is awaited; the gap is marked in ``lost``.

    Raises
    ------
    DriverError
        If the device cannot be opened, is silent, or went away and is not awaited.
    RecordingWriteError
        If the file cannot be written, such as on a full disk.
    ValueError
        If `raw` is asked of a driver that has no bytes.
    """
    if raw is not None and not isinstance(driver, StreamDriver):
        raise ValueError(f"`raw` needs a stream of bytes; {driver.address} has none")
    state = RecordState()
    with ExitStack() as stack:
        capture = None
        if raw is not None and isinstance(driver, StreamDriver):
            capture = stack.enter_context(
                CaptureWriter(raw, driver.address, driver.describe_stream)
            )
            driver.tap = capture.add
        sink = stack.enter_context(_Sink(path, capture))
        stack.callback(driver.close)
        driver.open()
        Recorder(driver, sink, state, limits, stop, progress).run(reconnect=reconnect)
    return state


class Recorder:
    """One run of `record`."""

    def __init__(
        self,
        driver: Driver,
        sink: _Sink,
        state: RecordState,
        limits: RecordLimits,
        stop: threading.Event,
        progress: Callable[[RecordState], None],
    ) -> None:
        self.driver = driver
        self.sink = sink
        self.state = state
        self.limits = limits
        self.stop = stop
        self.progress = progress
        self._shift = 0.0  # added to the driver's time, which restarts when it is reopened
        self._first: float | None = None
        self._last: tuple[float, float] | None = None  # recording time and host time of the last
        self._resumed = False
        self._earlier: Counter[str] = Counter()  # counters of the connections before this one

    def run(self, *, reconnect: bool) -> None:
        """Read until something ends it."""
        heard = time.monotonic()
        while not self.state.ended_by:
            try:
                batch = self.driver.read(POLL)
            except DeviceLostError as error:
                self._take(self.driver.finish())
                if not reconnect:
                    raise DeviceLostError(
                        f"{error}. The {self.state.samples} samples before are in "
                        f"{self.sink.path}; --reconnect waits for the device"
                    ) from error
                if self._await_device():
                    heard = time.monotonic()
                continue
            if batch is not None:
                heard = time.monotonic()
                self._take(batch)
            elif self.driver.ended:
                self.state.ended_by = "end of the source"
            elif time.monotonic() - heard > SILENCE:
                raise DriverTimeoutError(
                    f"{self.driver.address}: nothing came for {SILENCE:g} s, after "
                    f"{self.state.samples} samples. {self.driver.why_silent()}"
                )
            self.sink.flush(every=FLUSH)
            self.progress(self.state)
            if self.stop.is_set() and not self.state.ended_by:
                self.state.ended_by = "interrupt"
        if self.driver.is_open:
            self._take(self.driver.finish())
        self.sink.flush(every=0.0)

    def _await_device(self) -> bool:
        """Wait until the device is back; return False if told to stop meanwhile."""
        self._earlier += self.driver.counters
        self.driver.close()
        self.state.waiting = True
        while not self.stop.wait(RETRY):
            self.sink.flush(every=FLUSH)
            self.progress(self.state)
            if self._away_too_long():
                self.state.ended_by = "duration"
                break
            try:
                self.driver.open()
            except AWAY:
                continue
            self.state.waiting = False
            self.state.reconnects += 1
            self._resumed = True
            return True
        self.state.waiting = False
        self.state.ended_by = self.state.ended_by or "interrupt"
        return False

    def _away_too_long(self) -> bool:
        if self.limits.duration is None or self._last is None or self._first is None:
            return False
        recorded = self._last[0] - self._first
        return recorded + time.monotonic() - self._last[1] > self.limits.duration

    def _take(self, batch: Recording | None) -> None:
        state = self.state
        state.counters = self._earlier + self.driver.counters
        if batch is None or (state.ended_by and state.ended_by != "interrupt"):
            return
        cut = self._cut(self._place(batch))
        if cut is None:
            return
        batch = cut
        self.sink.remarks = {
            name.replace("_", " "): str(count)
            for name, count in sorted(state.counters.items())
            if name not in HARMLESS
        }
        self.sink.append(batch)
        assert batch.lost is not None
        assert self._first is not None
        self._last = (float(batch.time[-1]), time.monotonic())
        state.device, state.clock = batch.device, batch.clock
        state.samples += len(batch)
        state.lost += batch.samples_lost
        state.duration = self._last[0] - self._first
        if state.duration > 0:
            state.rate = (state.samples + state.lost - 1) / state.duration
        state.clipped += count_clipped(batch)
        if batch.temperature is not None:
            state.temperature = float(batch.temperature[-1])
        state.moving = self.sink.moving

    def _place(self, batch: Recording) -> Recording:
        """Put a batch after the ones before it; after a gap, where the host's clock says."""
        if self._resumed and self._last is not None:
            self._resumed = False
            end, when = self._last
            interval = 1.0 / self.state.rate if self.state.rate else 1e-3
            gap = max(time.monotonic() - when - batch.duration, interval)
            self._shift = end + gap - float(batch.time[0])
            assert batch.lost is not None
            lost = batch.lost.copy()
            lost[0] += max(round(gap / interval) - 1, 1)
            batch = replace(batch, lost=lost)
        if self._first is None:
            self._first = float(batch.time[0])
        return replace(batch, time=batch.time + self._shift) if self._shift else batch

    def _cut(self, batch: Recording) -> Recording | None:
        """Keep what the limits allow, and end the recording where they are reached."""
        keep = len(batch)
        if self.limits.samples is not None and self.state.samples + keep >= self.limits.samples:
            keep = self.limits.samples - self.state.samples
            self.state.ended_by = "samples"
        if self.limits.duration is not None and self._first is not None:
            end = self._first + self.limits.duration
            if batch.time[-1] >= end:
                keep = min(keep, int(np.searchsorted(batch.time, end, side="right")))
                self.state.ended_by = "duration"
        return batch.slice(0, keep) if keep else None


class _Sink:
    """The file: gathers batches, writes them every `FLUSH` s, and tells rest from motion."""

    def __init__(self, path: Path, capture: CaptureWriter | None) -> None:
        self.path = path
        self._capture = capture
        self._writer = open_writer(path)
        self._pending: list[Recording] = []
        self._statics = LiveStatics()
        self.moving: bool | None = None
        self.remarks: dict[str, str] = {}
        self._flushed = time.monotonic()
        self._broken = False

    def append(self, batch: Recording) -> None:
        self._pending.append(batch)

    def flush(self, *, every: float) -> None:
        if time.monotonic() - self._flushed < every:
            return
        self._flushed = time.monotonic()
        self._write()
        if self._capture is not None:
            self._capture.flush()

    def _write(self) -> None:
        pending, self._pending = self._pending, []
        if not pending:
            return
        samples = join(pending)
        self._writer.remarks = dict(self.remarks)
        try:
            self._writer.append(samples)
            self._writer.flush()
        except OSError as error:
            self._broken = True
            raise write_failure(self.path, error) from error
        self._statics.update(samples)
        self.moving = not self._statics.resting

    def __enter__(self) -> _Sink:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if not self._broken:
                self._write()
            self._writer.__exit__(kind, error, trace)
        except OSError as problem:
            if not isinstance(error, OSError):
                raise write_failure(self.path, problem) from problem


def write_failure(path: Path, error: OSError) -> RecordingWriteError:
    """Return the error to raise where a recording that grows cannot be written."""
    return RecordingWriteError(
        f"{path} cannot be written any more: {error.strerror or error}. What was written "
        "before can be read; free some space and record again"
    )


def count_clipped(batch: Recording) -> int:
    """Return how many samples have an axis at its full scale (within one count)."""
    clipped = np.zeros(len(batch), bool)
    device = batch.device
    for values, full, lsb in (
        (batch.accel, device.accel_full_scale, device.accel_lsb),
        (batch.gyro, device.gyro_full_scale, device.gyro_lsb),
    ):
        if full is not None:
            clipped |= (np.abs(values) >= full - 1.5 * (lsb or 0.0)).any(axis=1)
    return int(clipped.sum())
