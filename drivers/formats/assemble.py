"""From columns in SI units to checked recordings: invalid rows are named, or become gaps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.errors import InvalidSampleError
from calib.recording import CHANNELS, Clock, DeviceInfo, Recording
from calib.rounded_stamps import ROUNDED
from calib.timing import SHARED
from calib.types import BoolArray, FloatArray, IntArray
from drivers.formats.rounded import Rounded
from drivers.formats.ticks import Ticks

MAX_REVERSAL = 1.0
"""s; rows out of order may be dropped, but not a clock that started again."""


ALIKE, EXACT = (0.02, 1.1), 0.01
"""Shares of the usual step between which stamps are rounded to a tick, and of a tick by which
floating point leaves these off."""


JUST = 1e-9
"""s by which times follow each other where nothing else is known."""


SCATTERED = 0.05
"""Share of steps that differ from the usual one where a host is late: of an even clock no two
stamps are alike but by mistake."""


@dataclass
class Assembler:
    """Makes the batches of one recording, whatever file they come from.

    Keeps what runs on from batch to batch: the last time, the number of rows, and rows that were
    dropped at the end of a batch and so are lost before the next one. Coarse stamps that an even
    clock explains are put on its grid, and the note `ROUNDED` says so; where many samples share a
    stamp otherwise, they are counted on from it, and the note `SHARED` says that. A thermometer
    that is nan in every row is none.

    Parameters
    ----------
    name : str
        The file, for messages.
    drop_invalid : bool
        Leave rows out that are not finite or whose time does not increase, and count them in
        ``lost``; otherwise they are refused.
    row_name : function from row number (from 0) to str
        What a person calls that row: "line 17".
    """

    name: str
    clock: Clock
    device: DeviceInfo
    drop_invalid: bool
    row_name: Callable[[int], str] = lambda row: f"row {row + 1}"
    notes: dict[str, str] = field(default_factory=dict)
    complete: bool = True
    rows: int = 0
    dropped: int = 0
    _rounded: Rounded = field(default_factory=Rounded)
    _ticks: Ticks = field(default_factory=Ticks)
    _pending: int = 0
    _last: float = -np.inf
    _stamp: float = -np.inf
    _values: FloatArray | None = None
    """Of the row that was read last, as it is."""
    _warm: bool | None = None
    """Whether the thermometer says anything, once that is known."""

    def add(
        self,
        time: FloatArray,
        accel: FloatArray,
        gyro: FloatArray,
        temperature: FloatArray | None = None,
        lost: IntArray | None = None,
    ) -> Recording | None:
        """Return one batch, or None if no row of it can be used.

        Raises
        ------
        InvalidSampleError
            If a row is not finite or its time does not increase, unless ``drop_invalid``.
        """
        first = self.rows
        self.rows += len(time)
        if len(time) == 0:
            return None
        time = self._timed(time, accel, gyro, lost)
        temperature = self._measured(temperature, first)
        bad = self._not_finite(time, accel, gyro, temperature, first)
        late = self._not_increasing(time, bad, first)
        if late is not None:
            bad = late if bad is None else np.logical_or.reduce([bad, late])
        lost = np.zeros(len(time), np.int64) if lost is None else np.array(lost, np.int64)
        if bad is not None:
            lost, keep = self._gap(bad, lost)
            if not keep.any():
                return None
            time, accel, gyro, lost = time[keep], accel[keep], gyro[keep], lost[keep]
            temperature = None if temperature is None else temperature[keep]
        elif self._pending:
            lost[0] += self._pending
            self._pending = 0
        self._last = float(time[-1])
        return Recording(
            time=time,
            accel=accel,
            gyro=gyro,
            clock=self.clock,
            temperature=temperature,
            lost=lost,
            device=self.device,
            complete=self.complete,
            notes=self._notes(),
        )

    def _timed(
        self, stamps: FloatArray, accel: FloatArray, gyro: FloatArray, lost: IntArray | None
    ) -> FloatArray:
        """Return times that increase, where stamps say when samples were taken, if roughly."""
        even = None if self.clock == "invalid" else self._rounded.evened(stamps, lost)
        if even is not None:
            return even
        time = self._told_apart(self._ticks.counted_on(stamps), accel, gyro)
        if self._rounded.found is None:
            return time
        # The grid may have been ahead of its stamps by part of a tick.
        ahead = (time <= self._last) & (time > self._last - self._rounded.found.tick)
        return np.where(ahead, self._last + JUST * np.arange(1, len(time) + 1), time)

    def _told_apart(self, time: FloatArray, accel: FloatArray, gyro: FloatArray) -> FloatArray:
        """Return times of which those that rounding made alike are within what it hides.

        A late host and stamps in whole milliseconds give two samples one stamp now and then. A row
        that is there twice has the same values, too, and is left alike.
        """
        same = np.diff(time, prepend=self._stamp) == 0
        before, self._stamp = self._values, float(time[-1])
        self._values = np.concatenate((accel[-1], gyro[-1]))
        if not same.any():
            return time
        values = np.hstack((accel, gyro))
        first = values[:1] if before is None else before[None]
        other = (np.diff(values, axis=0, prepend=first) != 0).any(axis=1)
        step = np.diff(time)
        up = step[step > 0]
        if not up.size or not (other | ~same).all():
            return time
        tick, usual = _tick(up), float(np.median(up))
        scatter = float((np.abs(step - usual) > 0.5 * tick).mean())
        if not ALIKE[0] * usual < tick < ALIKE[1] * usual or scatter < SCATTERED:
            return time
        # Members of a group lie evenly in their tick; the first of all may go on from before.
        group = np.cumsum(~same)
        place = np.arange(len(time)) - np.searchsorted(group, group)
        place[group == 0] += 1
        count = np.bincount(group, minlength=1)
        count[0] += 1
        return np.asarray(time + tick * place / count[group])

    def _measured(self, temperature: FloatArray | None, first: int) -> FloatArray | None:
        """Return the temperature, None where no row has one."""
        if temperature is None:
            return None
        if self._warm is None:
            self._warm = not np.isnan(temperature).all()
        if not self._warm and not np.isnan(temperature).all():
            row = int(np.argmin(np.isnan(temperature)))
            raise InvalidSampleError(
                f"{self.name}, {self.row_name(first + row)}: temperature is {temperature[row]}, "
                "after rows that had none, expected one in each row or in none"
            )
        return temperature if self._warm else None

    def _notes(self) -> Mapping[str, str]:
        found = {} if self._warm is not False else {"temperature": "nan in every row: left out"}
        if self._rounded.found is not None:
            found[ROUNDED] = self._rounded.found.said
        elif self._ticks.interval:
            found[SHARED] = f"{self._ticks.tick:.4g} s apart, counted on between"
        if self.dropped:
            found["dropped_rows"] = str(self.dropped)
        return self.notes | found

    def _not_finite(
        self,
        time: FloatArray,
        accel: FloatArray,
        gyro: FloatArray,
        temperature: FloatArray | None,
        first: int,
    ) -> BoolArray | None:
        columns = [time[:, None], accel, gyro]
        names = ["time", *CHANNELS]
        if temperature is not None:
            columns.append(temperature[:, None])
            names.append("temperature")
        # A sum is finite if all terms are; look closer only if it is not.
        with np.errstate(over="ignore", invalid="ignore"):
            if all(np.isfinite(c.sum()) for c in columns):
                return None
        finite = np.hstack([np.isfinite(c) for c in columns])
        bad: BoolArray = np.logical_not(finite.all(axis=1, keepdims=True))[:, 0]
        if not bad.any():
            return None
        if not self.drop_invalid:
            row = int(np.argmax(bad))
            column = int(np.argmin(finite[row]))
            value = np.hstack([c[row] for c in columns])[column]
            raise InvalidSampleError(
                f"{self.name}, {self.row_name(first + row)}: {names[column]} is {value}, "
                f"expected a finite number ({_such(bad)}). --drop-invalid leaves "
                "these rows out and counts them as lost samples"
            )
        return bad

    def _not_increasing(
        self, time: FloatArray, bad: BoolArray | None, first: int
    ) -> BoolArray | None:
        step = np.diff(time, prepend=self._last)
        if bad is None and step.min() > 0:
            return None
        usable = time if bad is None else np.where(bad, -np.inf, time)
        latest = np.maximum.accumulate(np.concatenate([[self._last], usable[:-1]]))
        late: BoolArray = time <= latest
        if bad is not None:
            late &= ~bad
        if not late.any():
            return None
        row = int(np.argmax(late))
        what = (
            f"{self.name}, {self.row_name(first + row)}: time does not increase: {time[row]:.9g} s "
            f"after {latest[row]:.9g} s"
        )
        if not self.drop_invalid:
            raise InvalidSampleError(
                f"{what}, expected later ({_such(late)}). --drop-invalid leaves "
                "these rows out; if the clock started again, split the file there"
            )
        back = float((latest - time)[late].max())
        if back > MAX_REVERSAL:
            raise InvalidSampleError(
                f"{what}: the clock went back by {back:.3g} s, which is no row out of order. Split "
                "the file there and give both parts"
            )
        return late

    def _gap(self, bad: BoolArray, lost: IntArray) -> tuple[IntArray, BoolArray]:
        """Move what is lost with, and before, bad rows to the next good row."""
        keep = ~bad
        self.dropped += int(bad.sum())
        total = np.cumsum(lost + bad) + self._pending
        kept = total[keep]
        out = lost.copy()
        out[keep] = np.diff(kept, prepend=0)
        self._pending = int(total[-1] - (kept[-1] if kept.size else 0))
        return out, keep


def _tick(step: FloatArray) -> float:
    """Return the power of ten, in s, that all steps (n,) are multiples of, or else the shortest.

    0 if they are multiples of neither.
    """
    for tick in (0.1, 0.01, 1e-3, 1e-4, float(step.min())):
        count = step / tick
        if (np.abs(count - np.round(count)) < EXACT).all():
            return tick
    return 0.0


def _such(rows: BoolArray) -> str:
    count = int(rows.sum())
    return f"{count} such row{'s' if count != 1 else ''}"
