"""What flashing over a serial stream shares: connecting, measuring, and coming back."""

from __future__ import annotations

import time

import numpy as np

from calib.errors import DeviceLostError, DriverError
from calib.recording import DeviceInfo, Recording, join
from calib.types import FloatArray
from drivers.flash.target import Action, Target
from drivers.stream import StreamDriver

SETTLE = 0.5
"""s of samples that are passed over after a write: filters, and what was on its way."""
RETURN = 20.0
"""s to wait for a device that restarts; over USB it also has to be recognised again."""


class StreamTarget(Target):
    """A device behind a `StreamDriver`."""

    def __init__(self, driver: StreamDriver) -> None:
        super().__init__(driver.address)
        self._driver = driver

    @property
    def info(self) -> DeviceInfo:
        return self._driver.info

    def open(self) -> None:
        self._driver.open()

    def close(self) -> None:
        self._driver.close()

    def measure(self, duration: float) -> Recording:
        driver, batches = self._driver, list[Recording]()
        begin: float | None = None
        while not batches or batches[-1].time[-1] - batches[0].time[0] < duration:
            batch = driver.read(3.0)
            if batch is None:
                raise DeviceLostError(f"{self.address}: no samples came for 3 s")
            if begin is None:
                begin = float(batch.time[-1])  # the first batch may have waited for us
            fresh = int((batch.time < begin + SETTLE).sum())
            if fresh < len(batch):
                batches.append(batch.slice(fresh, len(batch)))
        return join(batches)

    def _reconnect(self) -> None:
        """Close, and open again when the device is back and its samples come."""
        self.close()
        deadline = time.monotonic() + RETURN
        while True:
            try:
                self.open()
                if self._driver.read(3.0) is not None:
                    return
                problem: DriverError = DeviceLostError(f"{self.address}: no samples come")
            except DriverError as error:
                problem = error
            self.close()
            if time.monotonic() > deadline:
                raise problem
            time.sleep(0.5)


def affine_action(
    old_matrix: FloatArray, old_bias: FloatArray, new_matrix: FloatArray, new_bias: FloatArray
) -> Action:
    """Return the action of changing ``m = C0 (a - B0)`` into ``m' = C1 (a - B1)``.

    With ``a = C0⁻¹ m + B0``: ``m' = C1 C0⁻¹ m + C1 (B0 - B1)``.
    """
    matrix = new_matrix @ np.linalg.inv(old_matrix)
    return Action(np.asarray(matrix), np.asarray(new_matrix @ (old_bias - new_bias)))
