"""When the samples of a chip were taken: by host time and a known rate, or by the chip's clock."""

from __future__ import annotations

import numpy as np

from calib.types import FloatArray, IntArray


class SampleTimes:
    """Sample numbers turned into times: the device's steady rate, locked to host time.

    The last sample of a read has a known mean `age`: half an interval where a FIFO's count is
    read, half a polling pause where a data-ready bit is watched. ``now - age`` observes its time.
    A Kalman filter over (time of the last sample, interval) follows these observations.
    """

    def __init__(self, rate: float, now: float, *, age: float) -> None:
        self.age = age
        self.interval = 1 / rate
        self.nominal = 1 / rate
        self.last_read = now
        self._origin = now
        self._last = 0.0
        self._started = False
        # Of the estimates: an IMU's oscillator is within a few per cent of its nominal rate.
        self._variance = np.diag([(2 * age) ** 2, (0.03 / rate) ** 2])
        # Of an observation: the age is even over its range, and reads are late by scheduling.
        self._noise = (2 * age) ** 2 / 12 + 2e-4**2

    def take(self, count: int, lost: int, now: float) -> FloatArray:
        """Return the times of the next `count` samples, `lost` samples after the one before."""
        observed = now - self._origin - self.age
        steps = count + lost
        if not self._started:
            self._started = True
            self._last = observed - steps * self.interval
        predict = np.array([[1.0, steps], [0.0, 1.0]])
        variance = predict @ self._variance @ predict.T
        # The rate drifts with temperature, by about 1e-6 of itself a second.
        variance[1, 1] += (1e-6 * self.interval) ** 2 * steps * self.interval
        gain = variance[:, 0] / (variance[0, 0] + self._noise)
        error = observed - (self._last + steps * self.interval)
        self._variance = variance - np.outer(gain, variance[0])
        # Never backwards, however late a read was: at least half the nominal interval.
        step = max(self.interval + gain[0] * error / steps, self.nominal / 2)
        self.interval = min(
            max(self.interval + gain[1] * error, 0.9 * self.nominal), 1.1 * self.nominal
        )
        times: FloatArray = self._last + step * np.arange(lost + 1, steps + 1, dtype=np.float64)
        self._last += step * steps
        return times

    def restart(self, now: float) -> int:
        """Return how many samples an emptied FIFO lost since the last one, or since the start."""
        elapsed = now - self._origin - (self._last if self._started else 0.0)
        return max(1, int(elapsed / self.interval))

    def missing(self, now: float) -> int:
        """Return how many samples went by unread, when one that is new is read at `now`."""
        if not self._started:
            return 0
        elapsed = now - self.age - self._origin - self._last
        return max(0, round(elapsed / self.interval) - 1)


class DeviceTimes:
    """The chip's own clock unwrapped, and the samples that it shows to be missing.

    Parameters
    ----------
    rate : float, Hz
        Samples and clock come from one oscillator, so that steps are whole intervals of it.
    period : float, s
        When the clock wraps around. Pauses longer than that are told apart by host time.
    """

    def __init__(self, rate: float, period: float) -> None:
        self._interval = 1 / rate
        self._period = period
        self._tick: float | None = None
        self._time = 0.0
        self._now = 0.0

    def take(self, ticks: FloatArray, now: float) -> tuple[FloatArray, IntArray]:
        """Return times from 0, and how many samples are missing before each, at host time `now`."""
        steps = np.diff(ticks, prepend=ticks[0] if self._tick is None else self._tick)
        steps = np.mod(steps, self._period)
        if self._tick is not None:
            rest = now - self._now - float(steps.sum())
            steps[0] += self._period * max(0, round(rest / self._period))
        times = self._time + np.cumsum(steps)
        lost = np.clip(np.rint(steps / self._interval) - 1, 0, None).astype(np.int64)
        self._tick, self._time, self._now = float(ticks[-1]), float(times[-1]), now
        return times, lost
