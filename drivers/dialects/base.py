"""What a serial dialect is: bytes to samples, pure and incremental, and what it says when it fails.

A `Dialect` is stateless; its `Parser` is fed with whatever chunks arrive, keeps an incomplete tail,
finds its way again after garbage, and counts what it could not use.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from calib.recording import DeviceInfo
from calib.types import BoolArray, FloatArray, IntArray

DEGREE = np.pi / 180.0


@dataclass(frozen=True, eq=False)
class Samples:
    """What a parser found, in SI units.

    Parameters
    ----------
    accel, gyro : (n, 3) arrays, m/s² and rad/s
    lost : (n,) array of int
        Samples known to be missing just before each one.
    temperature : (n,) array, °C, or None
    ticks : (n,) array, s, or None
        The device's own clock as it was sent, wrapping at `Parser.clock_period`.
    """

    accel: FloatArray
    gyro: FloatArray
    lost: IntArray
    temperature: FloatArray | None = None
    ticks: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.lost.size)

    def where(self, keep: BoolArray) -> Samples:
        """Return the samples that are kept; what was lost before the others stays counted."""
        total = np.cumsum(self.lost)[keep]
        return Samples(
            self.accel[keep],
            self.gyro[keep],
            np.diff(total, prepend=0),
            None if self.temperature is None else self.temperature[keep],
            None if self.ticks is None else self.ticks[keep],
        )

    @classmethod
    def join(cls, parts: Sequence[Samples]) -> Samples:
        """Return the parts as one batch; all or none of them have a temperature, and ticks."""
        if len(parts) == 1:
            return parts[0]

        def joined(name: str) -> FloatArray | None:
            values = [getattr(part, name) for part in parts]
            return None if values[0] is None else np.concatenate(values)

        return cls(
            np.concatenate([part.accel for part in parts]),
            np.concatenate([part.gyro for part in parts]),
            np.concatenate([part.lost for part in parts]),
            joined("temperature"),
            joined("ticks"),
        )

    @classmethod
    def none(cls) -> Samples:
        """Return an empty batch."""
        return cls(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.int64))


@dataclass(frozen=True)
class Reply:
    """A device's answer to a command, such as a register or a parameter value."""

    key: str
    values: tuple[Any, ...]


class Parser(ABC):
    """Turns one stream's bytes into samples. Subclasses override `_parse`."""

    clock_period: float | None = None
    """When the device's clock wraps around, s; None if it does not, or if there is none."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        """``skipped_bytes``, ``damaged_frames``, ... : everything that became no sample."""
        self.replies: deque[Reply] = deque(maxlen=1000)
        self.info = DeviceInfo()
        self.accepted_bytes = 0
        self._owed = 0  # bad samples at a batch's end, lost before the next batch's first
        self._rest = b""

    def feed(self, data: bytes) -> Samples:
        """Take the next bytes and return the samples that they complete."""
        buffer = self._rest + data if self._rest else data
        if not buffer:
            return Samples.none()
        samples, used = self._parse(buffer)
        self._rest = buffer[used:]
        return samples

    def finish(self) -> None:
        """Count an incomplete tail: nothing more will come."""
        if self._rest:
            self.counters["incomplete_bytes"] += len(self._rest)
        self._rest = b""

    def _without(self, samples: Samples, bad: BoolArray) -> Samples:
        """Return the samples that are not bad; the bad ones are lost before the next good one."""
        if not bad.any() and not self._owed:
            return samples
        lost = samples.lost + bad
        lost[0] += self._owed
        kept = replace(samples, lost=lost).where(~bad)
        self._owed = int(lost.sum() - kept.lost.sum())
        return kept

    def _count(self, name: str, number: int) -> None:
        if number:
            self.counters[name] += number

    @abstractmethod
    def _parse(self, buffer: bytes) -> tuple[Samples, int]:
        """Return the samples in `buffer` and how many of its bytes are done with."""


class Dialect(ABC):
    """One serial protocol. A file of this folder sets ``DIALECT`` to an instance."""

    name: str
    summary: str
    default_baud: int = 115200
    options: ClassVar[Mapping[str, str]] = {}
    """Options in the address and what they mean."""

    @abstractmethod
    def parser(self, options: Mapping[str, str]) -> Parser:
        """Return a new parser.

        Raises
        ------
        ValueError
            If an option has a value that is not understood.
        """

    def recognise(self, data: bytes) -> float:
        """Return the fraction of `data` that is whole frames of this dialect, 0 to 1."""
        parser = self.parser({})
        parser.feed(data)
        return parser.accepted_bytes / max(len(data), 1)
