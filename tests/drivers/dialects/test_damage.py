"""Damage that no parser may trip over: against byte-by-byte readers that know no vectors."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dialects import dialects, recognise
from drivers.dialects.base import Parser
from drivers.dialects.mavlink import MESSAGES
from drivers.dialects.vectornav import SENTENCES, layout_of
from drivers.emulators.arduino import ArduinoSketch
from drivers.emulators.autopilot import ARDUPILOT_FIRMWARE, PX4_FIRMWARE, Autopilot
from drivers.emulators.base import EmulatorOptions, make_sensor
from drivers.emulators.serial_device import SerialDevice
from drivers.emulators.vectornav import HEADER, VectorNavDevice
from drivers.emulators.witmotion import WitMotionDevice

SKETCH = {
    "columns": "t,ax,ay,az,gx,gy,gz,temp",
    "time_unit": "us",
    "accel_unit": "m/s^2",
    "gyro_unit": "rad/s",
}
COUNT = 12
SENTENCE = re.compile(rb"VN[A-Z]{3}(,[+-]?([0-9]+\.?[0-9]*|\.[0-9]+))+")


def device(name: str) -> SerialDevice:
    sensor = make_sensor(EmulatorOptions(seed=4), default_rate=100.0)
    return {
        "witmotion": lambda: WitMotionDevice(sensor),
        "vectornav": lambda: VectorNavDevice(sensor, binary=True),
        "vectornav-ascii": lambda: VectorNavDevice(sensor, binary=False),
        "px4": lambda: Autopilot(sensor, firmware=PX4_FIRMWARE),
        "ardupilot": lambda: Autopilot(sensor, firmware=ARDUPILOT_FIRMWARE),
        "arduino": lambda: ArduinoSketch(sensor),
    }[name]()


DIALECT_OF = {
    "witmotion": "witmotion",
    "vectornav": "vectornav",
    "vectornav-ascii": "vectornav",
    "px4": "mavlink",
    "ardupilot": "mavlink",
    "arduino": "text",
}


@cache
def stream(name: str) -> bytes:
    return device(name).stream(0, COUNT)


def new_parser(name: str) -> Parser:
    return dialects()[DIALECT_OF[name]].parser(SKETCH if name == "arduino" else {})


def test_every_dialect_is_here() -> None:
    assert set(DIALECT_OF.values()) == set(dialects())


# ---- naive readers: where a frame starts, how long it is, whether it carries a sample ----


def naive_witmotion(data: bytes, at: int) -> tuple[int, str]:
    frame = data[at : at + 11]
    if (
        len(frame) < 11
        or frame[0] != 0x55
        or frame[1] >> 4 != 5
        or sum(frame[:10]) % 256 != frame[10]
    ):
        return 0, ""
    return 11, {0x51: "accel", 0x52: "gyro", 0x5F: "reply"}.get(frame[1], "other")


def naive_vectornav(data: bytes, at: int) -> tuple[int, str]:
    if data[at] == 0x24:
        star = data.find(b"*", at)
        body = data[at + 1 : star]
        if star < 0 or len(body) < 5 or not body.startswith(b"VN") or star + 3 > len(data):
            return 0, ""
        if any(not 32 <= byte < 127 for byte in body):
            return 0, ""
        digits = data[star + 1 : star + 3]
        if any(chr(d) not in "0123456789abcdefABCDEF" for d in digits) or star - at >= 512:
            return 0, ""
        xor = 0
        for byte in body:
            xor ^= byte
        if xor != int(digits, 16):
            return 0, ""
        numbers = SENTENCE.fullmatch(body)  # the XOR does not see an inserted zero byte
        fields = SENTENCES.get(body[:5], (0,))[0]
        good = numbers is not None and body.count(b",") == fields
        return star + 3 - at, "ascii" if good else "other"
    layout = layout_of(HEADER)
    assert layout is not None
    frame = data[at : at + layout.length]
    if len(frame) < layout.length or not frame.startswith(HEADER):
        return 0, ""
    crc = 0
    for byte in frame[1:]:
        crc = ((crc >> 8) | (crc << 8)) & 0xFFFF  # the manual's form of the same CRC
        crc ^= byte
        crc ^= (crc & 0xFF) >> 4
        crc ^= (crc << 12) & 0xFFFF
        crc ^= (crc & 0xFF) << 5
    return (layout.length, "binary") if crc == 0 else (0, "")


def naive_mavlink(data: bytes, at: int) -> tuple[int, str]:
    two = data[at] == 0xFD
    head = 10 if two else 6
    if data[at] not in (0xFD, 0xFE) or at + head > len(data):
        return 0, ""
    size = data[at + 1]
    number = int.from_bytes(data[at + 7 : at + 10], "little") if two else data[at + 5]
    message = MESSAGES.get(number)
    if message is None or (size != message.size if not two else not 0 < size <= message.full):
        return 0, ""
    length = head + size + 2
    whole = length + (13 if two and data[at + 2] & 1 else 0)
    if at + whole > len(data):
        return 0, ""
    crc = 0xFFFF
    for byte in data[at + 1 : at + length - 2] + bytes([message.crc_extra]):
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    if crc != int.from_bytes(data[at + length - 2 : at + length], "little"):
        return 0, ""
    return whole, message.name


NAIVE: dict[str, Callable[[bytes, int], tuple[int, str]]] = {
    "witmotion": naive_witmotion,
    "vectornav": naive_vectornav,
    "vectornav-ascii": naive_vectornav,
    "px4": naive_mavlink,
    "ardupilot": naive_mavlink,
}
CARRIER = {
    "vectornav": "binary",
    "vectornav-ascii": "ascii",
    "px4": "HIGHRES_IMU",
    "ardupilot": "RAW_IMU",
}


def naive_samples(name: str, data: bytes) -> int:
    at, end, kinds = 0, 0, []
    while at < len(data):
        length, kind = NAIVE[name](data, at)
        if length:
            kinds.append((kind, at == end))
            at = end = at + length
        else:
            at += 1
    if name != "witmotion":
        return sum(kind == CARRIER[name] for kind, _ in kinds)
    pairs, open_half = 0, False
    for kind, adjacent in kinds:
        if kind == "reply":
            open_half &= adjacent
            continue
        pairs += open_half and adjacent and kind == "gyro"
        open_half = kind == "accel"
    return pairs


@st.composite
def damages(draw: st.DrawFn, size: int) -> list[tuple[str, int, bytes]]:
    place = st.integers(0, size - 1)
    cut = st.tuples(st.just("cut"), place, st.binary(min_size=1, max_size=80))
    insert = st.tuples(st.just("insert"), place, st.binary(min_size=1, max_size=40))
    flip = st.tuples(st.just("flip"), place, st.integers(0, 7).map(lambda k: bytes([1 << k])))
    return draw(st.lists(cut | insert | flip, min_size=1, max_size=5))


def apply(data: bytes, ops: list[tuple[str, int, bytes]]) -> bytes:
    out = bytearray(data)
    for kind, place, what in ops:
        if place >= len(out):
            continue
        if kind == "cut":
            del out[place : place + len(what)]
        elif kind == "insert":
            out[place:place] = what
        else:
            out[place] ^= what[0]
    return bytes(out)


def feed(parser: Parser, data: bytes, borders: list[int]) -> tuple[np.ndarray, int]:
    edges = [0, *sorted(b % (len(data) + 1) for b in borders), len(data)]
    parts = [parser.feed(data[a:b]) for a, b in pairwise(edges)]
    parser.finish()
    rows = np.vstack([np.hstack([part.accel, part.gyro]) for part in parts])
    return rows, int(sum(part.lost.sum() for part in parts))


@pytest.mark.parametrize("name", NAIVE)
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_damage_is_read_as_a_naive_reader_reads_it(name: str, data: st.DataObject) -> None:
    clean = stream(name)
    damaged = apply(clean, data.draw(damages(len(clean)))) + clean
    borders = data.draw(st.lists(st.integers(0, 10_000), max_size=6))
    # Learning which sentences and frames carry the samples is not what is tested here.
    rows, _ = feed(new_parser(name), clean + damaged, borders)
    assert len(rows) == naive_samples(name, clean + damaged)
    assert np.isfinite(rows).all()


@pytest.mark.parametrize("name", DIALECT_OF)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_one_damage_costs_no_more_than_it_touches(name: str, data: st.DataObject) -> None:
    clean = stream(name)
    reference, _ = feed(new_parser(name), clean * 2, [])
    place = data.draw(st.integers(0, len(clean) - 1))
    bit = data.draw(st.integers(0, 7))
    damaged = clean + apply(clean, [("flip", place, bytes([1 << bit]))]) + clean
    borders = data.draw(st.lists(st.integers(0, 10_000), max_size=6))
    rows, lost = feed(new_parser(name), damaged, borders)
    good = len(reference) * 3 // 2
    if name == "arduino":  # a digit may turn into another one, and a line end into two lines' loss
        assert good - 2 <= len(rows) <= good + 1
    else:
        assert good - 1 <= len(rows) <= good
        known = {row.tobytes() for row in reference}
        assert all(row.tobytes() in known for row in rows)
        assert lost <= 1


@pytest.mark.parametrize("name", DIALECT_OF)
@settings(max_examples=25, deadline=None)
@given(junk=st.lists(st.binary(max_size=300), max_size=6))
def test_junk_never_raises(name: str, junk: list[bytes]) -> None:
    parser = new_parser(name)
    parser.feed(stream(name))
    for piece in junk:
        parser.feed(piece)
    rows, _ = feed(parser, b"\n" + stream(name) * 2, [])
    assert len(rows) >= COUNT


@pytest.mark.parametrize("name", DIALECT_OF)
def test_recognised_from_its_bytes(name: str) -> None:
    data = stream(name)
    assert recognise(data[7:] * 2).name == DIALECT_OF[name]


@pytest.mark.parametrize("name", DIALECT_OF)
def test_lost_frames_are_counted(name: str) -> None:
    """What is missing shows: by sequence numbers, by the clock, or by the bytes that are left."""
    clean = stream(name)
    parser = new_parser(name)
    parser.feed(clean)
    middle = len(clean) // 2
    damaged = clean[:middle] + b"\x00\xff" + clean[middle + 2 :]
    samples = parser.feed(damaged)
    assert len(samples) in (COUNT - 1, COUNT)
    assert len(samples) + samples.lost.sum() == COUNT or parser.counters["skipped_bytes"]
    assert sum(parser.counters.values()) > 0
