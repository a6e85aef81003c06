"""Lines of delimited numbers to an array, a block at a time; a bad line costs itself alone."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from pyarrow import csv

from calib.types import BoolArray, FloatArray
from drivers.dialects.framing import Bytes, as_bytes

NUMBER = re.compile(rb"[ \t]*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?[ \t]*\r?")
SMALL = 48
"""Lines below which Python parses faster than a call of pyarrow takes."""


def parse_block(
    block: bytes, *, fields: int, places: Sequence[int], delimiter: bytes
) -> FloatArray | None:
    """Return the numbers at `places` of each line; None if any line is not `fields` numbers."""
    if block.count(b"\n") <= SMALL:
        return None
    try:
        return _fast(block, fields, places, delimiter)
    except pa.ArrowInvalid:
        return None


def parse_numbers(
    block: bytes, *, fields: int, places: Sequence[int], delimiter: bytes
) -> tuple[FloatArray, BoolArray]:
    """Return the numbers at `places` of each line, (n, places), and which lines are good.

    Every line must have `fields` fields and an end. Where the block does not parse as a whole, the
    lines that cannot be numbers are taken out; should that not help, the block is halved.
    """
    data = as_bytes(block)
    ends = np.flatnonzero(data == 10) + 1
    if ends.size > SMALL:
        try:
            return _fast(block, fields, places, delimiter), np.ones(ends.size, bool)
        except pa.ArrowInvalid:
            good = _well_formed(data, delimiter)
            values = np.zeros((ends.size, len(places)))
            if good.all():
                middle = int(ends[ends.size // 2 - 1])
                parts = [
                    parse_numbers(part, fields=fields, places=places, delimiter=delimiter)
                    for part in (block[:middle], block[middle:])
                ]
                return np.vstack([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
            kept = data[np.repeat(good, np.diff(ends, prepend=0))].tobytes()
            numbers, fine = parse_numbers(kept, fields=fields, places=places, delimiter=delimiter)
            good[good] = fine
            values[good] = numbers[fine]
            return values, good
    values, good = np.zeros((ends.size, len(places))), np.zeros(ends.size, bool)
    for k, line in enumerate(block.split(b"\n")[: ends.size]):
        parts_of_line = line.split(delimiter)
        if all(NUMBER.fullmatch(part) for part in parts_of_line):
            values[k] = [float(parts_of_line[place]) for place in places]
            good[k] = True
    return values, good


def _fast(block: bytes, fields: int, places: Sequence[int], delimiter: bytes) -> FloatArray:
    names = [str(k) for k in range(fields)]
    table = csv.read_csv(
        pa.BufferReader(block),
        csv.ReadOptions(use_threads=False, column_names=names, block_size=len(block) + 1),
        csv.ParseOptions(delimiter=delimiter.decode(), quote_char=False, ignore_empty_lines=False),
        csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=[]),
    )
    return np.column_stack([table.column(place).to_numpy() for place in places])


def _well_formed(data: Bytes, delimiter: bytes) -> BoolArray:
    """Return which lines have a number in every field, as far as neighbouring bytes can tell."""
    digit = (data >= 48) & (data <= 57)
    sign = (data == 43) | (data == 45)
    exponent = (data == 69) | (data == 101)
    dot = data == 46
    edge = (data == delimiter[0]) | (data == 10)
    blank = (data == 32) | (data == 9) | (data == 13)
    before = np.concatenate([[True], (edge | blank)[:-1]])
    bad = sign & ~before & ~np.concatenate([[False], exponent[:-1]])
    mantissa = digit | dot
    bad |= exponent & ~np.concatenate([[False], mantissa[:-1]])
    bad |= (sign | exponent) & np.concatenate([(edge | blank)[1:], [True]])
    # A blank between two parts of one field.
    bad |= (mantissa | sign) & np.concatenate([[False], (blank & ~before)[:-1]])
    fields = np.flatnonzero(edge)
    begins = np.concatenate([[0], fields[:-1] + 1])
    many = np.add.reduceat(dot.view(np.uint8), begins) > 1
    many |= np.add.reduceat(exponent.view(np.uint8), begins) > 1
    many |= ~np.logical_or.reduceat(digit, begins)
    bad[begins] |= many
    lines = np.concatenate([[0], np.flatnonzero(data == 10)[:-1] + 1])
    return ~np.logical_or.reduceat(bad, lines)
