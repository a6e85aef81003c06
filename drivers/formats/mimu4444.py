"""The MIMU4444 board's raw byte stream: a frame parser, fed with bytes as they come.

Frame of 106 bytes, big-endian: ``AA``, sequence u16, length ``64``, time u32 in 64 MHz ticks, then
for each of eight IMUs ax ay az gx gy gz s16, then u16 = sum of the first 104 bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import RecordingFormatError
from calib.recording import Recording
from calib.types import FloatArray, IntArray
from drivers.formats.assemble import Assembler
from drivers.formats.base import Format, ReadOptions, Source
from drivers.formats.profile import Profile, get_profile

SIZE = 106
IMUS = 8
FRAME = np.dtype(
    [
        ("start", "u1"),
        ("sequence", ">u2"),
        ("length", "u1"),
        ("ticks", ">u4"),
        ("imu", ">i2", (IMUS, 6)),
        ("checksum", ">u2"),
    ]
)
START, LENGTH = 0xAA, 0x64
SEQUENCES = 1 << 16
BLOCK = 1 << 20


class FrameParser:
    """Finds frames in a stream of bytes, wherever it begins and whatever is between them.

    Attributes
    ----------
    skipped : int
        Bytes before the latest frame that belong to no whole frame.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.skipped = 0
        self._idle = 0

    @property
    def pending(self) -> int:
        """Bytes after the latest frame: the beginning of another, or damage."""
        return self._idle + len(self._rest)

    def feed(self, data: bytes) -> NDArray[np.void]:
        """Return the whole frames that are in the stream so far and were not returned before."""
        stream = np.frombuffer(self._rest + data, np.uint8)
        at = _find_frames(stream)
        if not at.size:
            keep = min(len(stream), SIZE - 1)
            self._idle += len(stream) - keep
            self._rest = stream[len(stream) - keep :].tobytes()
            return np.zeros(0, FRAME)
        self.skipped += int(self._idle + at[-1] - SIZE * (len(at) - 1))
        self._idle = 0
        self._rest = stream[at[-1] + SIZE :].tobytes()
        if at[-1] - at[0] == SIZE * (len(at) - 1):
            return np.frombuffer(stream, FRAME, len(at), int(at[0]))
        frames: NDArray[np.void] = stream[at[:, None] + np.arange(SIZE)].view(FRAME)[:, 0]
        return frames


def _find_frames(stream: NDArray[np.uint8]) -> IntArray:
    """Return where frames begin: start byte, length byte and checksum agree."""
    if len(stream) < SIZE:
        return np.zeros(0, np.int64)
    last = len(stream) - SIZE + 1
    at = np.flatnonzero((stream[:last] == START) & (stream[3 : last + 3] == LENGTH))
    total = np.concatenate([[0], np.cumsum(stream, dtype=np.int64)])
    checksum = stream[at + SIZE - 2].astype(np.int64) * 256 + stream[at + SIZE - 1]
    at = at[(total[at + SIZE - 2] - total[at]) % SEQUENCES == checksum]
    # Data may look like a frame inside a frame; the one that is found first is kept.
    while (crowded := np.flatnonzero(np.diff(at) < SIZE)).size:
        at = np.delete(at, crowded[0] + 1)
    return at


class FrameClock:
    """Time and losses from sequence numbers (16 bit) and ticks (32 bit, 67 s), both wrapping."""

    def __init__(self, *, ticks_per_second: float, wraps: int) -> None:
        self._rate, self._wraps = ticks_per_second, wraps
        self._sequence: int | None = None
        self._ticks = 0
        self._elapsed = 0
        self._interval = 0.0

    def advance(self, sequence: IntArray, ticks: IntArray) -> tuple[FloatArray, IntArray]:
        """Return seconds since the first frame, and frames lost before each, (n,) each."""
        first = self._sequence is None
        before = int(sequence[0]) - 1 if first else self._sequence
        assert before is not None
        steps = np.diff(sequence, prepend=before) % SEQUENCES
        spans = np.diff(ticks, prepend=ticks[0] if first else self._ticks) % self._wraps
        if first:
            steps[0], spans[0] = 1, 0
        usual = spans[(steps == 1) & (spans > 0)]
        if usual.size:
            self._interval = float(np.median(usual))
        # A gap longer than the counter's period: the sequence says how many periods.
        if self._interval:
            spans += self._wraps * np.maximum(
                0, np.rint((steps * self._interval - spans) / self._wraps)
            ).astype(np.int64)
        elapsed = self._elapsed + np.cumsum(spans)
        self._sequence, self._ticks = int(sequence[-1]), int(ticks[-1])
        self._elapsed = int(elapsed[-1])
        return elapsed / self._rate, np.maximum(steps - 1, 0)


class Mimu4444(Format):
    """MIMU4444 byte stream."""

    name = "mimu4444"
    title = "MIMU4444 byte stream"
    several_sensors = True

    def sniff(self, head: bytes) -> bool:
        """Look for a whole frame with its checksum."""
        return bool(_find_frames(np.frombuffer(head, np.uint8)).size)

    def batches(self, source: Source, options: ReadOptions) -> Iterator[Recording]:
        """Replay the bytes through the parser and yield the samples of one IMU."""
        name, imu = str(source.path), options.imu
        if imu is None or not 1 <= imu <= IMUS:
            seen = "no --imu was given" if imu is None else f"--imu {imu} was given"
            raise RecordingFormatError(
                f"{name} holds {IMUS} IMUs and {seen}; say which one: --imu 1 to --imu {IMUS}"
            )
        profile = options.profile or get_profile("mimu4444")
        assembler = _assembler(name, imu, profile, options)
        time = profile.time
        if time is None or not time.factor or profile.accel is None or profile.gyro is None:
            raise RecordingFormatError(
                f"profile {profile.name} lacks [time], [accel] or [gyro], which frames need"
            )
        clock = FrameClock(ticks_per_second=1 / time.factor, wraps=time.wraps or 1 << 32)
        parser, buffer = FrameParser(), source.buffer
        _look_at_the_end(assembler, buffer)
        width = BLOCK if options.batch is None else min(BLOCK, options.batch * SIZE)
        for at in range(0, buffer.size, width):
            block = buffer.slice(at, min(width, buffer.size - at)).to_pybytes()
            frames = parser.feed(block)
            if parser.skipped:
                assembler.notes["skipped_bytes"] = str(parser.skipped)
            if not len(frames):
                continue
            values = frames["imu"][:, imu - 1].astype(np.float64)
            seconds, lost = clock.advance(
                frames["sequence"].astype(np.int64), frames["ticks"].astype(np.int64)
            )
            recording = assembler.add(
                seconds,
                profile.accel.to_si(values[:, :3]),
                profile.gyro.to_si(values[:, 3:]),
                lost=lost,
            )
            if recording is not None:
                yield recording
        if not assembler.rows:
            raise RecordingFormatError(f"{name}: no whole frame of {SIZE} bytes in it")


FORMAT = Mimu4444()


def _assembler(name: str, imu: int, profile: Profile, options: ReadOptions) -> Assembler:
    recognised = " (recognised from the file)" if options.profile is None else ""
    return Assembler(
        name=name,
        clock=profile.clock,
        device=replace(profile.device, serial_number=f"IMU {imu}"),
        drop_invalid=options.drop_invalid,
        row_name=lambda row: f"frame {row + 1}",
        notes={"profile": profile.name + recognised, **profile.notes},
    )


def _look_at_the_end(assembler: Assembler, buffer: Any) -> None:
    """Note at once whether the stream ends within a frame, for those who read it in batches."""
    tail = FrameParser()
    tail.feed(buffer.slice(max(0, buffer.size - BLOCK)).to_pybytes())
    if tail.pending:
        assembler.complete = False
        assembler.notes["cut"] = f"{tail.pending} bytes of an unfinished frame were left out"
