"""VectorNav: ASCII sentences ``$VN...*XX`` and binary frames ``FA``, which may be mixed.

An ASCII sentence ends in the XOR of the bytes between ``$`` and ``*``. A binary frame is FA, a
byte of group bits, a u16 of field bits for each group, the fields, and a CRC-16 (initial 0) over
all after FA. Where the stream holds both compensated and uncompensated signals the compensated
ones are taken (``signal=uncompensated`` takes the others): registers 25 and 84 act on those.

Source: VN-100 user manual; dawonn/vectornav.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

from calib.errors import AddressError
from calib.recording import DeviceInfo
from calib.types import BoolArray, FloatArray, IntArray
from drivers.dialects.base import Dialect, Parser, Reply, Samples
from drivers.dialects.framing import Bytes, as_bytes, crc16_ccitt, in_order, windows
from drivers.dialects.numbers import parse_numbers

SYNC, DOLLAR, STAR = 0xFA, 0x24, 0x2A
LONGEST = 512
"""Bytes of the longest frame or sentence that is waited for."""
SENTENCES: dict[bytes, tuple[int, int, int, int | None, bool]] = {
    # header: fields, where accel, gyro and temperature stand, whether they are compensated
    b"VNIMU": (11, 3, 6, 9, False),
    b"VNMAR": (9, 3, 6, None, True),
    b"VNYMR": (12, 6, 9, None, True),
    b"VNQMR": (13, 7, 10, None, True),
}
GROUPS: dict[int, tuple[tuple[str, int], ...]] = {
    # group bit: (name, bytes) of each field, in the order of its bits
    0: (
        *(("time_startup", 8), ("time_gps", 8), ("time_sync_in", 8), ("ypr", 12)),
        *(("quaternion", 16), ("gyro", 12), ("position", 24), ("velocity", 12), ("accel", 12)),
        *(("imu", 24), ("mag_pres", 20), ("delta", 28), ("ins_status", 2), ("sync_in_count", 4)),
        ("time_gps_pps", 8),
    ),
    1: (
        *(("time_startup", 8), ("time_gps", 8), ("gps_tow", 8), ("gps_week", 2)),
        *(("time_sync_in", 8), ("time_gps_pps", 8), ("time_utc", 8), ("sync_in_count", 4)),
        *(("sync_out_count", 4), ("time_status", 1)),
    ),
    2: (
        *(("imu_status", 2), ("uncomp_mag", 12), ("uncomp_accel", 12), ("uncomp_gyro", 12)),
        *(("temperature", 4), ("pressure", 4), ("delta_theta", 16), ("delta_velocity", 12)),
        *(("mag", 12), ("accel", 12), ("gyro", 12), ("saturation", 2)),
    ),
    4: (
        *(("vpe_status", 2), ("ypr", 12), ("quaternion", 16), ("dcm", 36), ("mag_ned", 12)),
        *(("accel_ned", 12), ("linear_accel_body", 12), ("linear_accel_ned", 12), ("ypr_u", 12)),
    ),
}


@dataclass(frozen=True)
class Layout:
    """What a binary header announces: the frame's length and where its fields begin."""

    length: int
    places: Mapping[str, int]


@cache
def layout_of(header: bytes) -> Layout | None:
    """Return the layout that ``FA groups fields...`` announces; None if it is none we know."""
    if len(header) < 2:
        return None
    groups = [bit for bit in range(8) if header[1] >> bit & 1]
    if not groups or any(group not in GROUPS for group in groups):
        return None
    place = 2 + 2 * len(groups)
    if len(header) < place:
        return None
    places: dict[str, int] = {}
    for k, group in enumerate(groups):
        bits = int.from_bytes(header[2 + 2 * k : 4 + 2 * k], "little")
        if not bits or bits >> len(GROUPS[group]):
            return None
        for bit, (name, size) in enumerate(GROUPS[group]):
            if bits >> bit & 1:
                if name == "imu":
                    places |= {"uncomp_accel": place, "uncomp_gyro": place + 12}
                elif name == "mag_pres":
                    places["temperature"] = place + 12
                else:
                    places[name] = place
                place += size
    return Layout(place + 2, places)


def command(body: str) -> bytes:
    """Return ``$body*XX`` with its checksum and line end, as in ``command("VNRRG,25")``."""
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode("ascii")


def binary_frames(header: bytes, payload: Bytes) -> Bytes:
    """Return frames ``header + payload + CRC``, one for each row of payload."""
    rows = np.empty((payload.shape[0], len(header) + payload.shape[1] + 2), np.uint8)
    rows[:, : len(header)] = as_bytes(header)
    rows[:, len(header) : -2] = payload
    crc = crc16_ccitt(rows[:, 1:-2])
    rows[:, -2], rows[:, -1] = crc >> 8, crc & 0xFF
    return rows


class VectorNavParser(Parser):
    """Parser of a VectorNav stream."""

    def __init__(self, *, signal: str) -> None:
        super().__init__()
        self.info = DeviceInfo(chip="vectornav")
        self._signal = signal
        self._header: bytes | None = None  # of the binary frames that carry the samples
        self._kind: bytes | None = None  # of the sentences that carry them
        self._skipped = 0  # bytes outside frames since the last sample

    def _parse(self, buffer: bytes) -> tuple[Samples, int]:
        data = as_bytes(buffer)
        starts, ends = self._sentences(data)
        ascii_count = starts.size
        binary = self._binary(data, starts, ends)
        starts = np.concatenate([starts, binary])
        length = self._layout.length if self._header else 0
        ends = np.concatenate([ends, binary + length])
        is_ascii = np.arange(starts.size) < ascii_count
        order = np.argsort(starts, kind="stable")
        starts, ends, is_ascii = starts[order], ends[order], is_ascii[order]
        keep = in_order(starts, ends)
        starts, ends, is_ascii = starts[keep], ends[keep], is_ascii[keep]
        used = self._tail(data, int(ends[-1]) if ends.size else 0)
        gaps = self._gaps(data, starts, ends, used)
        self.accepted_bytes += int((ends - starts).sum())
        return self._decode(data, starts, ends, is_ascii, gaps), used

    @property
    def _layout(self) -> Layout:
        layout = layout_of(self._header or b"")
        assert layout is not None
        return layout

    def _sentences(self, data: Bytes) -> tuple[IntArray, IntArray]:
        """Return where sentences with a good checksum start and end."""
        dollars = np.flatnonzero(data[:-2] == DOLLAR)
        dollars = dollars[(data[dollars + 1] == ord("V")) & (data[dollars + 2] == ord("N"))]
        if not dollars.size:
            return dollars, dollars
        stars = np.flatnonzero(data == STAR)
        which = np.searchsorted(stars, dollars)
        dollars, which = dollars[which < stars.size], which[which < stars.size]
        stars = stars[which]
        fits = (stars + 2 < data.size) & (stars - dollars < LONGEST) & (stars - dollars > 5)
        dollars, stars = dollars[fits], stars[fits]
        if not dollars.size:
            return dollars, stars
        xor = np.concatenate([[np.uint8(0)], np.bitwise_xor.accumulate(data)])
        want = (_HEX[data[stars + 1]].astype(np.int64) << 4) | _HEX[data[stars + 2]]
        good = (xor[stars] ^ xor[dollars + 1]) == want
        # A XOR does not see a byte that came twice, such as two line ends.
        strange = np.concatenate([[0], np.cumsum((data < 32) | (data > 126))])
        good &= strange[stars] == strange[dollars]
        return dollars[good], stars[good] + 3

    def _binary(self, data: Bytes, starts: IntArray, ends: IntArray) -> IntArray:
        """Return where binary frames with the stream's header and a good CRC start."""
        if self._header is None:
            self._learn_header(data)
        if self._header is None:
            return np.empty(0, np.int64)
        length, head = self._layout.length, self._header
        if data.size < length:
            return np.empty(0, np.int64)
        at = np.flatnonzero(data[: data.size - length + 1] == SYNC)
        for k in range(1, len(head)):
            at = at[data[at + k] == head[k]]
        good = crc16_ccitt(windows(data, at, length)[:, 1:]) == 0
        found: IntArray = at[good]
        bad = at[~good]
        found = found[in_order(found, found + length)]
        if bad.size:
            before = np.searchsorted(found, bad) - 1
            outside = (before < 0) | (found[before] + length <= bad) if found.size else before < 0
            self._count("damaged_frames", int(outside.sum()))
        return found

    def _learn_header(self, data: Bytes) -> None:
        """Take the header of the first frame that has signals and a good CRC."""
        for at in np.flatnonzero(data == SYNC):
            header = data[at : at + 2 + 2 * 8].tobytes()
            if len(header) < 2:
                return
            header = header[: 2 + 2 * header[1].bit_count()]
            layout = layout_of(header)
            if layout is None or at + layout.length > data.size:
                continue
            frame = data[at : at + layout.length]
            if int(crc16_ccitt(frame[None, 1:])[0]) == 0 and self._names(layout) is not None:
                self._header = header
                return

    def _names(self, layout: Layout) -> tuple[str, str] | None:
        """Return the names of the accelerometer and gyroscope fields to use."""
        choices = [("accel", "gyro"), ("uncomp_accel", "uncomp_gyro")]
        if self._signal == "uncompensated":
            choices = choices[1:]
        elif self._signal == "compensated":
            choices = choices[:1]
        return next((c for c in choices if set(c) <= set(layout.places)), None)

    def _tail(self, data: Bytes, end: int) -> int:
        """Return how far the buffer is done with: up to what may be a frame's beginning."""
        begin = max(end, data.size - LONGEST)
        rest = data[begin:]
        possible = np.flatnonzero((rest == SYNC) | (rest == DOLLAR))
        if self._header is not None and possible.size:
            # A binary frame that fitted whole has been judged.
            whole = (rest[possible] == SYNC) & (possible + self._layout.length <= rest.size)
            possible = possible[~whole]
        return begin + int(possible[0]) if possible.size else data.size

    def _gaps(self, data: Bytes, starts: IntArray, ends: IntArray, used: int) -> IntArray:
        """Count the bytes before each frame that are in none; line ends do not count."""
        bounds = np.concatenate([[0], np.minimum(ends, used)])
        if np.array_equal(np.append(starts, used), bounds):
            return np.zeros(bounds.size, np.int64)
        stray = np.concatenate([[0], np.cumsum((data[:used] != 13) & (data[:used] != 10))])
        gaps: IntArray = stray[np.append(starts, used)] - stray[bounds]
        if not self.accepted_bytes and gaps.size > 1:
            self._count("incomplete_bytes", int(gaps[0]))  # we came in the middle of a frame
            gaps[0] = 0
        self._count("skipped_bytes", int(gaps.sum()))
        return gaps

    def _decode(
        self, data: Bytes, starts: IntArray, ends: IntArray, is_ascii: BoolArray, gaps: IntArray
    ) -> Samples:
        carries = ~is_ascii if self._header else np.zeros(starts.size, bool)
        for k in np.flatnonzero(is_ascii):
            sentence = data[starts[k] + 1 : ends[k] - 3].tobytes()
            kind = sentence[:5]
            if kind not in SENTENCES:
                self.replies.append(_reply(sentence))
            elif self._header is None and self._wanted(kind):
                self._kind = self._kind or kind
                carries[k] = kind == self._kind
        total = np.cumsum(gaps) + self._skipped
        before = total[:-1][carries]
        skipped = np.diff(before, prepend=0)
        self._skipped = int(total[-1] - (before[-1] if before.size else 0))
        if not carries.any():
            return Samples.none()
        starts, ends = starts[carries], ends[carries]
        lost = np.rint(skipped / np.median(ends - starts)).astype(np.int64)
        if self._header:
            return self._from_binary(data, starts, lost)
        return self._from_ascii(data, starts, ends, lost)

    def _wanted(self, kind: bytes) -> bool:
        return self._signal == "any" or (self._signal == "compensated") == SENTENCES[kind][4]

    def _from_binary(self, data: Bytes, starts: IntArray, lost: IntArray) -> Samples:
        layout = self._layout
        rows, places = windows(data, starts, layout.length), layout.places
        names = self._names(layout)
        assert names is not None

        def floats(name: str, count: int) -> FloatArray:
            part = rows[:, places[name] : places[name] + 4 * count]
            return part.copy().view("<f4").astype(np.float64)

        accel, gyro = floats(names[0], 3), floats(names[1], 3)
        ticks = temperature = None
        if "time_startup" in places:
            begin = places["time_startup"]
            ticks = rows[:, begin : begin + 8].copy().view("<u8")[:, 0] * 1e-9
        if "temperature" in places:
            temperature = floats("temperature", 1)[:, 0]
        return self._finite(Samples(accel, gyro, lost, temperature, ticks))

    def _from_ascii(self, data: Bytes, starts: IntArray, ends: IntArray, lost: IntArray) -> Samples:
        assert self._kind is not None
        fields, accel, gyro, temperature, _ = SENTENCES[self._kind]
        # Every sentence without its header and checksum, as a line.
        edges = np.zeros(data.size + 1, np.int8)
        edges[starts + 7], edges[ends - 2] = 1, -1
        text = data.copy()
        text[ends - 3] = 10
        block = text[np.cumsum(edges[:-1], dtype=np.int8).view(bool)].tobytes()
        places = [*range(accel, accel + 3), *range(gyro, gyro + 3)]
        places += [] if temperature is None else [temperature]
        lines = block.split(b"\n")[:-1]
        whole = np.array([line.count(b",") == fields - 1 for line in lines])
        if not whole.all():
            kept = [line for line, is_whole in zip(lines, whole, strict=True) if is_whole]
            block = b"".join(line + b"\n" for line in kept)
        numbers, fine = parse_numbers(block, fields=fields, places=places, delimiter=b",")
        values = np.full((starts.size, len(places)), np.nan)
        values[np.flatnonzero(whole)[fine]] = numbers[fine]
        return self._finite(
            Samples(
                values[:, :3],
                values[:, 3:6],
                lost,
                None if temperature is None else values[:, 6],
            )
        )

    def _finite(self, samples: Samples) -> Samples:
        """Drop samples that are not finite, and count them as lost."""
        signals = np.hstack([samples.accel, samples.gyro])
        good: BoolArray = np.logical_and.reduce(np.isfinite(signals), axis=1)
        if samples.temperature is not None:
            good &= np.isfinite(samples.temperature)
        self._count("invalid_samples", int((~good).sum()))
        return self._without(samples, ~good)


_HEX = np.full(256, 0xFF, np.uint8)
for _digit in b"0123456789ABCDEFabcdef":
    _HEX[_digit] = int(chr(_digit), 16)


def _reply(sentence: bytes) -> Reply:
    """Return ``VNRRG,25,1,0,...`` as key ``VNRRG,25`` and numbers (text where it is no number)."""
    words = sentence.decode("ascii", "replace").split(",")
    key = 2 if words[0] in ("VNRRG", "VNWRG") else 1
    values: list[float | str] = []
    for word in words[key:]:
        try:
            values.append(float(word))
        except ValueError:
            values.append(word)
    return Reply(",".join(words[:key]), tuple(values))


class VectorNav(Dialect):
    """The VectorNav protocol."""

    name = "vectornav"
    summary = "VectorNav VN-100/200/300, ASCII and binary"
    options: ClassVar[Mapping[str, str]] = {"signal": "any, compensated or uncompensated"}

    def parser(self, options: Mapping[str, str]) -> Parser:
        """Return a new parser."""
        signal = options.get("signal", "any")
        if signal not in ("any", "compensated", "uncompensated"):
            raise AddressError(f"signal={signal} can be any, compensated or uncompensated")
        return VectorNavParser(signal=signal)


DIALECT = VectorNav()
