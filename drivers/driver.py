"""The `Driver`: one protocol for live, replayed and emulated devices."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from types import TracebackType
from typing import Self

from calib.recording import DeviceInfo, Recording


class Driver(ABC):
    """A source of samples. The constructor does no I/O; `open` does.

    A driver overrides `info`, `_open`, `_close` and `_read`. It is made from an address by
    `drivers.transports.open_driver`.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.is_open = False
        self.ended = False
        """True once the source has said that nothing more will come (end of a replay)."""
        self.counters: Counter[str] = Counter()
        """What went wrong since `open`, by name: ``damaged_frames``, ``skipped_bytes``,
        ``unpaired_halves``, ``fifo_overflows``, ... Nothing is dropped that is not counted here."""

    @property
    @abstractmethod
    def info(self) -> DeviceInfo:
        """What is known of the device; complete only after `open`."""

    @abstractmethod
    def _open(self) -> None:
        """Connect and start the stream; if it fails, leave nothing open."""

    @abstractmethod
    def _close(self) -> None:
        """Stop the stream and let go of the device; the device may be gone already."""

    @abstractmethod
    def _read(self, timeout: float) -> Recording | None:
        """Return what has arrived, waiting at most `timeout` seconds for the first sample."""

    def open(self) -> None:
        """Connect and start the stream. Opening an open driver is harmless.

        Raises
        ------
        DriverError
            Its subclasses say whether it is missing, busy, forbidden, or another device.
        """
        if not self.is_open:
            self.ended = False
            self._open()
            self.is_open = True

    def close(self) -> None:
        """Stop the stream and let go of the device. Closing twice is harmless."""
        if self.is_open:
            self.is_open = False
            self._close()

    def read(self, timeout: float) -> Recording | None:
        """Return the samples that arrived since the last call, as one batch.

        Time runs on from batch to batch, and ``lost`` counts what went missing before each sample.

        Parameters
        ----------
        timeout : float, s
            How long to wait for the first sample.

        Returns
        -------
        Recording or None
            None if nothing came in time, or if the source has `ended`.

        Raises
        ------
        DeviceLostError
            If the device went away.
        ValueError
            If `timeout` is negative or the driver is not open.
        """
        if timeout < 0:
            raise ValueError(f"`timeout` must not be negative, got {timeout}")
        if not self.is_open:
            raise ValueError(f"{self.address} is not open")
        return None if self.ended else self._read(timeout)

    def finish(self) -> Recording | None:
        """Return the samples that were read but not handed out yet, as the stream ends here."""
        return None if self.ended or not self.is_open else self._finish()

    def _finish(self) -> Recording | None:
        return None

    def why_silent(self) -> str:
        """Return what to look at where no samples come."""
        return "Is the device still on, and streaming?"

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
