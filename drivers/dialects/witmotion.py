"""WitMotion (WT901 family): 11-byte frames ``55 TT`` with four s16 and a sum.

Acceleration (51) and angular rate (52) come in two frames; a sample is a 52 that follows its 51
with no byte lost or damaged between them. Units: 51 is 16 g and its fourth word is
temperature/100 °C; 52 is 2000 dps, full scale 32768.

Source: WITMOTION/WitStandardProtocol_JY901.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from calib.recording import DeviceInfo
from calib.types import FloatArray, IntArray
from drivers.dialects.base import DEGREE, Dialect, Parser, Reply, Samples
from drivers.dialects.framing import Bytes, as_bytes, in_order, windows

LENGTH = 11
ACCEL, GYRO, REGISTER = 0x51, 0x52, 0x5F
ACCEL_LSB = 16.0 * STANDARD_GRAVITY / 32768
GYRO_LSB = 2000.0 * DEGREE / 32768
TEMPERATURE_LSB = 0.01
UNLOCK = bytes.fromhex("ffaa6988b5")
SAVE = bytes.fromhex("ffaa000000")
RESTART = bytes.fromhex("ffaa00ff00")


def write_register(register: int, value: int) -> bytes:
    """Return the command that writes a 16-bit register (after `UNLOCK`)."""
    return struct.pack("<BBBH", 0xFF, 0xAA, register, value & 0xFFFF)


def read_register(register: int) -> bytes:
    """Return the command that asks for four registers; the reply's key is ``registers``."""
    return struct.pack("<BBBH", 0xFF, 0xAA, 0x27, register)


def frame(kind: int, words: FloatArray) -> Bytes:
    """Return frames of one kind, (n, 11), from (n, 4) words that are rounded and clipped to s16."""
    values = np.clip(np.rint(words), -32768, 32767).astype("<i2")
    rows = np.empty((values.shape[0], LENGTH), np.uint8)
    rows[:, 0], rows[:, 1] = 0x55, kind
    rows[:, 2:10] = values.view(np.uint8).reshape(-1, 8)
    rows[:, 10] = rows[:, :10].sum(axis=1, dtype=np.uint8)
    return rows


class WitMotionParser(Parser):
    """Parser of the WitMotion stream."""

    def __init__(self) -> None:
        super().__init__()
        self.info = DeviceInfo(
            chip="witmotion",
            accel_full_scale=16.0 * STANDARD_GRAVITY,
            gyro_full_scale=2000.0 * DEGREE,
            accel_lsb=ACCEL_LSB,
            gyro_lsb=GYRO_LSB,
        )
        # Over the stream, register replies left out: frames, bytes, unpaired 51, unpaired 52.
        self._totals = np.zeros(4, np.int64)
        self._last: IntArray | None = None  # the totals at the last good sample
        self._cycle = 2 * LENGTH  # bytes from one sample to the next

    def _parse(self, buffer: bytes) -> tuple[Samples, int]:
        data = as_bytes(buffer)
        starts, damaged = self._find(data)
        used = max(int(starts[-1]) + LENGTH if starts.size else 0, data.size - LENGTH + 1, 0)
        signals = np.flatnonzero(data[starts + 1] != REGISTER)
        if signals.size and data.size - used < LENGTH:
            k = int(signals[-1])
            if data[starts[k] + 1] == ACCEL and int(starts[-1]) + LENGTH >= used:
                used, starts = int(starts[k]), starts[:k]  # its other half may still come
        self.accepted_bytes += LENGTH * starts.size
        if starts.size and self.accepted_bytes == LENGTH * starts.size:
            self._count("incomplete_bytes", int(starts[0]))  # we came in the middle of a frame
            self._count("skipped_bytes", used - LENGTH * starts.size - int(starts[0]))
        else:
            self._count("skipped_bytes", used - LENGTH * starts.size)
        self._count("damaged_frames", int((damaged < used).sum()))
        return self._pair(data, starts, used), used

    def _find(self, data: Bytes) -> tuple[IntArray, IntArray]:
        """Return where valid frames start, and where damaged ones seem to."""
        if data.size < LENGTH:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        last = data.size - LENGTH + 1
        candidates = np.flatnonzero((data[:last] == 0x55) & (data[1 : last + 1] >> 4 == 5))
        total = np.concatenate([[np.uint8(0)], np.cumsum(data, dtype=np.uint8)])
        good = total[candidates + 10] - total[candidates] == data[candidates + 10]
        starts, bad = candidates[good], candidates[~good]
        starts = starts[in_order(starts, starts + LENGTH)]
        if bad.size and starts.size:
            before = np.searchsorted(starts, bad) - 1
            bad = bad[(before < 0) | (starts[before] + LENGTH <= bad)]
        return starts, bad

    def _pair(self, data: Bytes, starts: IntArray, used: int) -> Samples:
        kinds = data[starts + 1]
        replies = kinds == REGISTER
        for row in windows(data, starts[replies], LENGTH):
            self.replies.append(Reply("registers", struct.unpack("<4h", row[2:10].tobytes())))
        places = (starts - LENGTH * (np.cumsum(replies) - replies))[~replies]
        starts, kinds = starts[~replies], kinds[~replies]
        joined = (kinds[:-1] == ACCEL) & (kinds[1:] == GYRO) & (np.diff(places) == LENGTH)
        first = np.concatenate([joined, [False]])[: kinds.size]
        second = np.concatenate([[False], joined])[: kinds.size]
        # The totals just before each frame.
        lone = np.stack([(kinds == ACCEL) & ~first, (kinds == GYRO) & ~second], axis=1)
        totals = np.column_stack(
            [np.arange(kinds.size), places, np.cumsum(lone, axis=0) - lone]
        ).astype(np.int64)
        totals += self._totals
        removed = LENGTH * int(replies.sum())
        self._totals += [kinds.size, used - removed, *lone.sum(axis=0)]
        at = starts[first]
        if self._last is None:  # we came in the middle of a cycle
            early = int(lone[: int(np.argmax(first)) if at.size else None].sum())
            self._count("incomplete_bytes", LENGTH * early)
            self._count("unpaired_halves", int(lone.sum()) - early)
        else:
            self._count("unpaired_halves", int(lone.sum()))
        if not at.size:
            return Samples.none()
        accel = windows(data, at + 2, 8).copy().view("<i2").astype(np.float64)
        gyro = windows(data, at + LENGTH + 2, 6).copy().view("<i2").astype(np.float64)
        return Samples(
            accel[:, :3] * ACCEL_LSB,
            gyro * GYRO_LSB,
            self._lost(totals[first]),
            temperature=accel[:, 3] * TEMPERATURE_LSB,
        )

    def _lost(self, totals: IntArray) -> IntArray:
        """Count the samples missing before each good one, from the halves and bytes in between."""
        before = totals[:1] if self._last is None else self._last[None]
        self._last = totals[-1]
        frames, size, *halves = np.diff(totals, axis=0, prepend=before).T
        clean = (size == LENGTH * frames) & (frames > 0) & (halves[0] + halves[1] == 0)
        if clean.any():
            self._cycle = int(np.median(size[clean]))
        excess = size - self._cycle
        lost = np.maximum.reduce(
            [*halves, np.where(excess >= LENGTH, np.maximum(np.rint(excess / self._cycle), 1), 0)]
        )
        return np.where(clean, 0, lost).astype(np.int64)


class WitMotion(Dialect):
    """The WitMotion protocol."""

    name = "witmotion"
    summary = "WitMotion WT901 family, binary frames 55 51 and 55 52"

    def parser(self, options: Mapping[str, str]) -> Parser:
        """Return a new parser; there are no options."""
        return WitMotionParser()


DIALECT = WitMotion()
