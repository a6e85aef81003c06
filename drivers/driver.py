"""The `Driver`: one protocol for live, replayed and emulated devices."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from calib.recording import DeviceInfo, Recording


class Driver(ABC):
    """A source of samples. The constructor does no I/O; `open` does.

    A driver overrides `open`, `close` and `_read`.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.ended = False
        """True once the source has said that nothing more will come (end of a replay)."""

    @property
    @abstractmethod
    def info(self) -> DeviceInfo:
        """What is known of the device; complete only after `open`."""

    @abstractmethod
    def open(self) -> None:
        """Connect and start the stream.

        Raises
        ------
        DriverError
            Its subclasses say whether it is missing, busy, forbidden, or another device.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop the stream and let go of the device. Closing twice is harmless."""

    @abstractmethod
    def _read(self, timeout: float) -> Recording | None:
        """Return what has arrived, waiting at most `timeout` seconds for the first sample."""

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
        """
        if timeout < 0:
            raise ValueError(f"`timeout` must not be negative, got {timeout}")
        return None if self.ended else self._read(timeout)

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
