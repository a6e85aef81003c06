"""A session on a device: read, record, decide, show, until every target is met."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors import ImuError, RecordingError
from calib.recording import Recording
from drivers.driver import Driver
from drivers.formats import open_writer, read_recording
from drivers.record import write_failure
from imu_cli.bench.screen import Header
from imu_cli.bench.session import Session, Status

POLL = 0.2
"""s that one read may wait, so that Ctrl-C is obeyed at once."""
SLICE = 0.5
"""s of samples that the session looks at in one go, however fast they come."""
FLUSH = 0.5
"""s between writes to the disk."""
PAUSE = 1.0
"""s put between a recording that is resumed and what follows it."""


@dataclass(frozen=True)
class Outcome:
    """How a session ended: ``done``, ``source ended`` or ``interrupted``."""

    ended: str
    status: Status
    elapsed: float


def run_session(
    session: Session,
    driver: Driver,
    path: Path,
    *,
    earlier: Recording | None,
    stop: threading.Event,
    show: Callable[[Status, Header], None],
) -> Outcome:
    """Run a session; the recording at `path` grows as samples come.

    A session that ends by itself marks the recording's clean end. One that is interrupted or
    killed leaves it cut, and `earlier` of the next run takes it up.

    Raises
    ------
    DriverError
        If the device cannot be opened, or went away.
    RecordingWriteError
        If the file cannot be written, such as on a full disk.
    """
    with _failures_named(path), ExitStack() as stack:
        writer = open_writer(path)
        stack.push(writer)
        end = 0.0
        if earlier is not None:
            earlier = replace(earlier, complete=True)
            writer.append(earlier)
            session.add(earlier)
            end = float(earlier.time[-1]) + PAUSE
        driver.open()
        stack.callback(driver.close)
        shift, flushed, lost = None, time.monotonic(), 0
        begun = end
        status = session.status()
        while True:
            batch = driver.read(POLL)
            if batch is not None:
                if shift is None:
                    shift = end - float(batch.time[0]) if earlier is not None else 0.0
                    batch = _mark_gap(batch) if earlier is not None else batch
                    begun = float(batch.time[0]) + shift
                batch = replace(batch, time=batch.time + shift)
                for part in slices(batch):
                    writer.append(part)
                    session.add(part)
                    lost += part.samples_lost
                    status = session.status()
                    elapsed = float(part.time[-1]) - begun
                    show(status, _header(driver, part, lost, elapsed))
                    if status.done and not status.moving:
                        return Outcome("done", status, elapsed)
            if time.monotonic() - flushed > FLUSH:
                writer.flush()
                flushed = time.monotonic()
            if driver.ended:
                return Outcome("source ended", status, _elapsed(session, begun))
            if stop.is_set():
                stack.pop_all()
                driver.close()
                writer.flush()
                _leave_cut(writer)
                return Outcome("interrupted", status, _elapsed(session, begun))


@contextmanager
def _failures_named(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if isinstance(error, (ImuError, BrokenPipeError)):
            raise
        raise write_failure(path, error) from error


def load_earlier(path: Path) -> Recording | None:
    """Return the samples of an interrupted session, or None if there is nothing to take up.

    Raises
    ------
    RecordingError
        If the file is a recording that ended cleanly: it would be overwritten.
    """
    if not path.exists() or path.stat().st_size == 0:
        return None
    recording = read_recording(path)
    if recording.complete:
        raise RecordingError(
            f"{path} is a finished recording; name another file with -o, or use --overwrite"
        )
    return recording


def slices(batch: Recording, *, width: float = SLICE) -> Iterator[Recording]:
    """Cut a batch into parts of at most `width` seconds."""
    start = 0
    while start < len(batch):
        stop = int(np.searchsorted(batch.time, batch.time[start] + width, side="right"))
        yield batch.slice(start, stop)
        start = stop


def _mark_gap(batch: Recording) -> Recording:
    """Count at least one lost sample before the first: nobody knows what happened in the pause."""
    lost = np.array(batch.lost)
    lost[0] = max(int(lost[0]), 1)
    return replace(batch, lost=lost)


def _leave_cut(writer: object) -> None:
    """Close the file without its end mark, so that the next session takes it up."""
    writer.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)  # type: ignore[attr-defined]


def _elapsed(session: Session, begun: float) -> float:
    recording = session.recording
    return 0.0 if recording is None else float(recording.time[-1]) - begun


def _header(driver: Driver, part: Recording, lost: int, elapsed: float) -> Header:
    info = driver.info
    rate = info.rate or (1 / part.interval if part.interval else 0.0)
    return Header(driver.address, info.chip, rate, lost, elapsed)
