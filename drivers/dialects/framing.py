"""Finding checksummed frames in a byte stream, vectorised over all places where one may start."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from calib.types import BoolArray, IntArray

Bytes = NDArray[np.uint8]


def as_bytes(data: bytes) -> Bytes:
    """View bytes as a read-only array."""
    return np.frombuffer(data, np.uint8)


def windows(data: Bytes, starts: IntArray, length: int) -> Bytes:
    """Return the `length` bytes from each start, as (n, length)."""
    if data.size < length:
        return np.empty((0, length), np.uint8)
    return np.lib.stride_tricks.sliding_window_view(data, length)[starts]


def in_order(starts: IntArray, ends: IntArray, begin: int = 0) -> BoolArray:
    """Return which of the frames ``[start, end)``, sorted by start, do not overlap an earlier one.

    The first valid frame wins, and what begins inside it is its content.
    """
    if not starts.size:
        return np.zeros(0, bool)
    if starts[0] >= begin and (starts[1:] >= ends[:-1]).all():
        return np.ones(starts.size, bool)
    keep = np.zeros(starts.size, bool)
    for k, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        if start >= begin:
            keep[k] = True
            begin = end
    return keep


def crc16_ccitt(rows: Bytes) -> NDArray[np.uint16]:
    """CRC-16 with polynomial 1021, most significant bit first, initial 0, of each row.

    The CRC of a message with its big-endian CRC appended is 0.
    """
    table = _table(0x1021, reflected=False)
    crc = np.zeros(rows.shape[0], np.uint16)
    for column in rows.T:
        crc = (crc << np.uint16(8)) ^ table[(crc >> np.uint16(8)) ^ column]
    return crc


def crc16_mcrf4xx(rows: Bytes) -> NDArray[np.uint16]:
    """CRC-16/MCRF4XX (polynomial 1021 reflected, initial FFFF) of each row: MAVLink's checksum."""
    table = _table(0x8408, reflected=True)
    crc = np.full(rows.shape[0], 0xFFFF, np.uint16)
    for column in rows.T:
        crc = (crc >> np.uint16(8)) ^ table[(crc & np.uint16(0xFF)) ^ column]
    return crc


@cache
def _table(polynomial: int, *, reflected: bool) -> NDArray[np.uint16]:
    table = []
    for byte in range(256):
        crc = byte if reflected else byte << 8
        for _ in range(8):
            if reflected:
                crc = (crc >> 1) ^ (polynomial if crc & 1 else 0)
            else:
                crc = ((crc << 1) ^ (polynomial if crc & 0x8000 else 0)) & 0xFFFF
        table.append(crc)
    return np.array(table, np.uint16)
