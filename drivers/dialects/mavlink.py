"""MAVLink 1 and 2: RAW_IMU, SCALED_IMU (and 2, 3) and HIGHRES_IMU of PX4 and ArduPilot.

A frame is FE (version 1) or FD (version 2), a header, a payload whose trailing zeros version 2
leaves off, and CRC-16/MCRF4XX over all after the first byte and a byte that stands for the
message's definition. Sequence numbers tell how many messages were lost, the time between samples
how many of them were samples.

HIGHRES_IMU is SI. SCALED_IMU is milli-g and mrad/s. RAW_IMU has no stated unit: ArduPilot sends
milli-g and mrad/s; for others ``accel_lsb`` and ``gyro_lsb`` (m/s² and rad/s per count) must say.

Source: MAVLink common message set (crc_extra and layouts as in pymavlink's definitions).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.errors import AddressError, BadFrameError
from calib.gravity import STANDARD_GRAVITY
from calib.recording import DeviceInfo
from calib.types import BoolArray, FloatArray, IntArray
from drivers.dialects.base import Dialect, Parser, Reply, Samples
from drivers.dialects.framing import Bytes, as_bytes, crc16_mcrf4xx, in_order, windows

V1, V2 = 0xFE, 0xFD
SIGNATURE = 13
LONGEST = 280
"""Bytes of the longest frame."""
BETWEEN = 1 << 14
"""Bytes of other messages between two of ours that are kept for their sequence numbers."""
ARDUPILOT, PX4 = 3, 12
"""Autopilots, as HEARTBEAT names them."""
PATIENCE = 200
"""RAW_IMU messages to wait for a heartbeat that says what their unit is."""
MILLI_G = STANDARD_GRAVITY / 1000


@dataclass(frozen=True)
class Message:
    """What is needed of a message: ``size`` without extension fields, ``full`` with them."""

    number: int
    name: str
    crc_extra: int
    size: int
    full: int


MESSAGES = {
    m.number: m
    for m in (
        Message(0, "HEARTBEAT", 50, 9, 9),
        Message(20, "PARAM_REQUEST_READ", 214, 20, 20),
        Message(22, "PARAM_VALUE", 220, 25, 25),
        Message(23, "PARAM_SET", 168, 23, 23),
        Message(26, "SCALED_IMU", 170, 22, 24),
        Message(27, "RAW_IMU", 144, 26, 29),
        Message(76, "COMMAND_LONG", 152, 33, 33),
        Message(77, "COMMAND_ACK", 143, 3, 10),
        Message(105, "HIGHRES_IMU", 93, 62, 63),
        Message(116, "SCALED_IMU2", 76, 22, 24),
        Message(129, "SCALED_IMU3", 46, 22, 24),
    )
}
BY_NAME = {m.name: m for m in MESSAGES.values()}
IMU = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""In the order in which they are preferred."""
FULL = max(m.full for m in MESSAGES.values())
RAW_DTYPE = np.dtype([("time", "<u8"), ("accel", "<i2", 3), ("gyro", "<i2", 3), ("mag", "<i2", 3)])
RAW_DTYPE = np.dtype([*RAW_DTYPE.descr, ("id", "u1"), ("temperature", "<i2")])
SCALED_DTYPE = np.dtype(
    [
        *[("time", "<u4"), ("accel", "<i2", 3), ("gyro", "<i2", 3), ("mag", "<i2", 3)],
        ("temperature", "<i2"),
    ]
)
HIGHRES_DTYPE = np.dtype(
    [
        *[("time", "<u8"), ("accel", "<f4", 3), ("gyro", "<f4", 3), ("mag", "<f4", 3)],
        *[("pressure", "<f4", 3), ("temperature", "<f4"), ("updated", "<u2"), ("id", "u1")],
    ]
)


def frames(
    message: Message, payload: Bytes, sequence: IntArray, *, system: int = 1, component: int = 1
) -> list[bytes]:
    """Return version 2 frames, one for each row of full-length payload."""
    nonzero = payload != 0
    last = payload.shape[1] - np.argmax(nonzero[:, ::-1], axis=1)
    sizes = np.where(nonzero.any(axis=1), last, 1)
    out: list[bytes] = [b""] * len(payload)
    for size in np.unique(sizes).tolist():
        mine = np.flatnonzero(sizes == size)
        rows = np.zeros((mine.size, 10 + size + 2), np.uint8)
        rows[:, 0], rows[:, 1], rows[:, 5], rows[:, 6] = V2, size, system, component
        rows[:, 4] = sequence[mine] & 0xFF
        rows[:, 7], rows[:, 8] = message.number & 0xFF, message.number >> 8
        rows[:, 10:-2] = payload[mine, :size]
        rows[:, -2] = message.crc_extra
        crc = crc16_mcrf4xx(rows[:, 1:-1])
        rows[:, -2], rows[:, -1] = crc & 0xFF, crc >> 8
        for k, row in zip(mine.tolist(), rows, strict=True):
            out[k] = row.tobytes()
    return out


def param_set(name: str, value: bytes, kind: int, *, system: int, component: int) -> bytes:
    """Return a PARAM_SET frame; `value` is the four bytes that go on the wire."""
    payload = value + struct.pack("<BB16sB", system, component, name.encode("ascii"), kind)
    return _one(BY_NAME["PARAM_SET"], payload)


def param_request(name: str, *, system: int, component: int) -> bytes:
    """Return a PARAM_REQUEST_READ frame."""
    payload = struct.pack("<hBB16s", -1, system, component, name.encode("ascii"))
    return _one(BY_NAME["PARAM_REQUEST_READ"], payload)


def command_long(number: int, *parameters: float, system: int, component: int) -> bytes:
    """Return a COMMAND_LONG frame."""
    values = (*parameters, *[0.0] * (7 - len(parameters)))
    payload = struct.pack("<7fHBBB", *values, number, system, component, 0)
    return _one(BY_NAME["COMMAND_LONG"], payload)


def _one(message: Message, payload: bytes) -> bytes:
    """Return one frame from a ground station (system 255, component 190)."""
    row, first = as_bytes(payload)[None], np.zeros(1, np.int64)
    return frames(message, row, first, system=255, component=190)[0]


@dataclass(frozen=True, eq=False)
class Frames:
    """Valid frames, sorted: where they start and end, what they are, who sent them."""

    start: IntArray
    end: IntArray
    number: IntArray
    sequence: IntArray
    source: IntArray
    payload: IntArray
    size: IntArray

    def where(self, keep: BoolArray | IntArray) -> Frames:
        """Return some of the frames."""
        return Frames(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


class MavlinkParser(Parser):
    """Parser of a MAVLink stream."""

    def __init__(
        self, *, message: str | None, accel_lsb: float | None, gyro_lsb: float | None
    ) -> None:
        super().__init__()
        self.info = DeviceInfo(chip="mavlink")
        self._message = BY_NAME[message] if message else None
        self._scale = (accel_lsb, gyro_lsb) if accel_lsb and gyro_lsb else None
        self._source: int | None = None
        self._sequence: int | None = None  # of the last frame of our source
        self._missing = 0  # messages of our source missing since the last sample
        self._last_tick: float | None = None
        self._interval = 0.0
        self._has_temperature: bool | None = None
        self._without_unit = 0

    def _parse(self, buffer: bytes) -> tuple[Samples, int]:
        data = as_bytes(buffer)
        found = self._find(data)
        if not found.start.size:
            used = max(data.size - BETWEEN, 0)
            self._count("skipped_bytes", used)
            return Samples.none(), used
        missing = self._follow(data, found)
        self.accepted_bytes += int((found.end - found.start).sum())
        for k in np.flatnonzero(~np.isin(found.number, [BY_NAME[n].number for n in IMU])):
            self._reply(data, found.where(np.array([k])))
        samples = self._decode(data, found, missing)
        return samples, int(found.end[-1])

    def _find(self, data: Bytes) -> Frames:
        """Return the frames of known messages whose checksum is good."""
        padded = np.concatenate([data, np.zeros(LONGEST, np.uint8)])
        at = np.flatnonzero((data == V1) | (data == V2))
        two = data[at] == V2
        size = padded[at + 1].astype(np.int64)
        number = np.where(two, padded[at + 7], padded[at + 5]).astype(np.int64)
        high = padded[at + 8].astype(np.int64) | padded[at + 9]
        signed = two & (padded[at + 2] & 1 == 1)
        head = np.where(two, 10, 6)
        end = at + head + size + 2 + SIGNATURE * signed
        known = np.zeros(256, np.int64)
        exact = np.full(256, -1, np.int64)
        for message in MESSAGES.values():
            known[message.number], exact[message.number] = message.full, message.size
        fits = np.where(two, (size <= known[number]) & (size > 0) & (high == 0), True)
        fits &= np.where(two, True, size == exact[number]) & (end <= data.size)
        fits &= known[number] > 0
        at, size, number, head, end = at[fits], size[fits], number[fits], head[fits], end[fits]
        good = np.zeros(at.size, bool)
        for kind in np.unique(np.stack([head, size, number]), axis=1).T if at.size else ():
            mine = (head == kind[0]) & (size == kind[1]) & (number == kind[2])
            rows = windows(padded, at[mine] + 1, int(kind[0] + kind[1])).copy()
            rows[:, -1] = MESSAGES[int(kind[2])].crc_extra
            crc = at[mine] + kind[0] + kind[1]
            good[mine] = crc16_mcrf4xx(rows) == (
                padded[crc] | padded[crc + 1].astype(np.uint16) << 8
            )
        starts, ends = at[good], end[good]
        bad_start, bad_number = at[~good], number[~good]
        keep = in_order(starts, ends)
        place = starts[keep] + np.where(head[good][keep] == 10, 4, 2)
        found = Frames(
            starts[keep],
            ends[keep],
            number[good][keep],
            sequence=padded[place].astype(np.int64),
            source=padded[place + 1].astype(np.int64) << 8 | padded[place + 2],
            payload=starts[keep] + head[good][keep],
            size=size[good][keep],
        )
        if found.start.size:
            done = bad_start < found.end[-1]
            before = np.searchsorted(found.start, bad_start) - 1
            outside = (before < 0) | (found.end[before] <= bad_start)
            damaged = done & outside & (bad_number != 0)
            self._count("damaged_frames", int(damaged.sum()))
        return found

    def _follow(self, data: Bytes, found: Frames) -> IntArray:
        """Return how many messages of our source are missing before each frame.

        Between two known frames lie whole frames of unknown messages; they are hopped over from
        length to length, all gaps at once. What does not end at the next frame is damage.
        """
        count = found.start.size
        place = np.concatenate([[0], found.end[:-1]])
        padded = np.concatenate([data, np.zeros(LONGEST, np.uint8)])
        known = np.isin(np.arange(256), list(MESSAGES))
        hopped, damaged = np.zeros(count, np.int64), np.zeros(count, np.int64)
        source = self._source
        while True:
            magic = padded[place]
            two = magic == V2
            going = (place < found.start) & (two | (magic == V1))
            if not going.any():
                break
            length = padded[place + 1].astype(np.int64) + np.where(two, 12, 8)
            length += SIGNATURE * (two & (padded[place + 2] & 1 == 1))
            going &= place + length <= found.start
            if not going.any():
                break
            sender = place + np.where(two, 5, 3)
            who = padded[sender].astype(np.int64) << 8 | padded[sender + 1]
            ours = who == (found.source[0] if source is None else source)
            # A message that we know is here because its checksum was bad.
            broken = known[padded[place + np.where(two, 7, 5)]] & (
                ~two | (padded[place + 8] | padded[place + 9] == 0)
            )
            hopped += going & ours & ~broken
            damaged += np.where(going & broken, length, 0)
            place = np.where(going, place + length, place)
        skipped = found.start - place + damaged
        between = found.start - np.concatenate([[0], found.end[:-1]])
        explained = int((between - skipped).sum())
        if not self.accepted_bytes:
            self._count("incomplete_bytes", int(skipped[0]))
            skipped[0] = 0
        self._count("skipped_bytes", int(skipped.sum()))
        self.accepted_bytes += explained
        if source is None:
            source = self._choose(found)
        mine = found.source == source
        missing = np.zeros(count, np.int64)
        if mine.any():
            total = np.cumsum(hopped)[mine]
            sequence = found.sequence[mine]
            before = sequence[0] - 1 - total[0] if self._sequence is None else self._sequence
            step = np.diff(sequence, prepend=before) - np.diff(total, prepend=0)
            missing[mine] = (step - 1) % 256
            self._sequence = int(sequence[-1])
        return missing

    def _choose(self, found: Frames) -> int:
        """Choose which sender and which of its messages the samples are taken from."""
        present = [MESSAGES[int(n)].name for n in np.unique(found.number)]
        if self._message is None:
            best = next((name for name in IMU if name in present), None)
            if best is None:
                return -1
            self._message = BY_NAME[best]
        senders = found.source[found.number == self._message.number]
        if not senders.size:
            return -1
        self._source = int(senders[0])
        return self._source

    def _decode(self, data: Bytes, found: Frames, missing: IntArray) -> Samples:
        if self._message is None or self._source is None:
            return Samples.none()
        ours = (found.source == self._source) & (found.number == self._message.number)
        total = np.cumsum(missing) + self._missing
        before = total[ours]
        self._missing = int(total[-1] - (before[-1] if before.size else 0))
        if not ours.any():
            return Samples.none()
        mine = found.where(ours)
        rows = _payloads(data, mine)
        at_most = np.diff(before, prepend=0)
        if self._message.name == "HIGHRES_IMU":
            return self._highres(rows, at_most)
        if self._message.name == "RAW_IMU":
            values = rows[:, : RAW_DTYPE.itemsize].copy().view(RAW_DTYPE)[:, 0]
            scale, tick = self._raw_scale(len(values)), 1e-6
            if scale is None:
                return Samples.none()
        else:
            values = rows[:, : SCALED_DTYPE.itemsize].copy().view(SCALED_DTYPE)[:, 0]
            scale, tick = (MILLI_G, 1e-3), 1e-3
            self.clock_period = 2**32 * 1e-3
        if self._has_temperature is None:
            self._has_temperature = bool(values["temperature"].any())
        ticks = values["time"].astype(np.float64) * tick
        return Samples(
            values["accel"] * scale[0],
            values["gyro"] * scale[1],
            self._lost(ticks, at_most),
            values["temperature"] * 0.01 if self._has_temperature else None,
            ticks,
        )

    def _highres(self, rows: Bytes, at_most: IntArray) -> Samples:
        values = rows[:, : HIGHRES_DTYPE.itemsize].copy().view(HIGHRES_DTYPE)[:, 0]
        ticks = values["time"].astype(np.float64) * 1e-6
        accel, gyro = values["accel"].astype(np.float64), values["gyro"].astype(np.float64)
        heat = values["temperature"].astype(np.float64)
        samples = Samples(accel, gyro, self._lost(ticks, at_most), heat, ticks)
        everything = np.hstack([accel, gyro, heat[:, None]])
        bad: BoolArray = ~np.logical_and.reduce(np.isfinite(everything), axis=1)
        # An old value that was not updated is no sample; 0 is a sender that does not say.
        stale = (values["updated"] != 0) & (values["updated"] & 0x3F != 0x3F)
        self._count("invalid_samples", int(bad.sum()))
        self._count("stale_samples", int((stale & ~bad).sum()))
        return self._without(samples, bad | stale)

    def _raw_scale(self, count: int) -> tuple[float, float] | None:
        if self._scale is None:
            self._without_unit += count
            if self._without_unit > PATIENCE:
                raise BadFrameError(
                    "RAW_IMU has no stated unit, and no ArduPilot heartbeat came: state "
                    "accel_lsb= (m/s² per count) and gyro_lsb= (rad/s per count) in the address, "
                    "or take another message with message=HIGHRES_IMU"
                )
            self._count("samples_without_unit", count)
        return self._scale  # type: ignore[return-value]

    def _lost(self, ticks: FloatArray, at_most: IntArray) -> IntArray:
        """Tell from the time between samples how many of the missing messages were samples."""
        first = self._last_tick if self._last_tick is not None else float(ticks[0])
        steps = np.diff(ticks, prepend=first)
        clean = steps[(at_most == 0) & (steps > 0)]
        if clean.size:
            self._interval = float(np.median(clean))
        self._last_tick = float(ticks[-1])
        if not self._interval:
            return np.zeros(ticks.size, np.int64)
        likely = np.rint(steps / self._interval) - 1
        lost: IntArray = np.clip(likely, 0, at_most).astype(np.int64)
        return lost

    def _reply(self, data: Bytes, one: Frames) -> None:
        payload = _payloads(data, one)[0].tobytes()
        name = MESSAGES[int(one.number[0])].name
        if name == "HEARTBEAT":
            _, kind, autopilot = struct.unpack_from("<IBB", payload)
            sender = int(one.source[0])
            self.replies.append(Reply(name, (kind, autopilot, sender >> 8, sender & 0xFF)))
            if autopilot == ARDUPILOT and self._scale is None:
                self._scale = (MILLI_G, 1e-3)
        elif name == "PARAM_VALUE":
            raw, count, index, text, kind = struct.unpack_from("<4sHH16sB", payload)
            parameter = text.split(b"\0")[0].decode("ascii", "replace")
            self.replies.append(Reply(f"PARAM_VALUE,{parameter}", (raw, kind, index, count)))
        elif name == "COMMAND_ACK":
            number, result = struct.unpack_from("<HB", payload)
            self.replies.append(Reply(f"COMMAND_ACK,{number}", (result,)))


def _payloads(data: Bytes, found: Frames) -> Bytes:
    """Return the payloads with the zeros that version 2 left off, (n, FULL)."""
    padded = np.concatenate([data, np.zeros(FULL, np.uint8)])
    rows = windows(padded, found.payload, FULL).copy()
    rows[np.arange(FULL) >= found.size[:, None]] = 0
    return rows


class Mavlink(Dialect):
    """The MAVLink protocol."""

    name = "mavlink"
    summary = "MAVLink 1 and 2: PX4 and ArduPilot autopilots"
    default_baud = 57600
    options: ClassVar[Mapping[str, str]] = {
        "message": f"{', '.join(IMU)}; the first of these that comes if left out",
        "accel_lsb": "m/s² per count of RAW_IMU",
        "gyro_lsb": "rad/s per count of RAW_IMU",
    }

    def parser(self, options: Mapping[str, str]) -> Parser:
        """Return a new parser."""
        message = options.get("message")
        if message is not None and message not in IMU:
            raise AddressError(f"message={message} can be {', '.join(IMU)}")
        if ("accel_lsb" in options) != ("gyro_lsb" in options):
            raise AddressError("give accel_lsb and gyro_lsb, or neither")
        return MavlinkParser(
            message=message,
            accel_lsb=_positive(options, "accel_lsb"),
            gyro_lsb=_positive(options, "gyro_lsb"),
        )


def _positive(options: Mapping[str, str], key: str) -> float | None:
    if key not in options:
        return None
    try:
        value = float(options[key])
    except ValueError:
        value = 0.0
    if not 0 < value < np.inf:
        raise AddressError(f"{key}={options[key]} must be a positive number")
    return value


DIALECT = Mavlink()
