"""The MIMU4444 frame parser: any cut of the stream, junk between frames, both counters wrapping."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import RecordingFormatError
from drivers.formats import open_batches, read_recording
from drivers.formats.mimu4444 import FRAME, SIZE, FrameClock, FrameParser

RNG = np.random.default_rng
TICKS = 1_024_000  # 62.5 Hz of a 64 MHz counter


def frames(n: int, *, seed: int = 0, sequence: int = 0, ticks: int = 0) -> np.ndarray:
    """Return frames as the board sends them, built field by field."""
    out = np.zeros(n, FRAME)
    out["start"], out["length"] = 0xAA, 0x64
    out["sequence"] = (sequence + np.arange(n)) % 65536
    out["ticks"] = (ticks + TICKS * np.arange(n, dtype=np.int64)) % 2**32
    out["imu"] = RNG(seed).integers(-32768, 32768, (n, 8, 6))
    raw = out.view(np.uint8).reshape(n, SIZE)
    out["checksum"] = raw[:, :104].sum(axis=1, dtype=np.int64) % 65536
    return out


def test_the_frame_is_the_documented_one() -> None:
    raw = frames(1, sequence=0x0102, ticks=0x03040506).tobytes()
    assert len(raw) == 106
    assert raw[:8].hex(" ") == "aa 01 02 64 03 04 05 06"
    assert int.from_bytes(raw[104:], "big") == sum(raw[:104]) % 65536


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 10),
    junk=st.lists(st.binary(max_size=150), min_size=11, max_size=11),
    cuts=st.lists(st.integers(0, 5000), max_size=12),
)
@settings(max_examples=80, deadline=None)
def test_every_frame_is_found_whatever_is_around_it(
    seed: int, n: int, junk: list[bytes], cuts: list[int]
) -> None:
    sent = frames(n, seed=seed)
    # Junk holds no start byte, so that it can hide no frame; half frames are tested below.
    gaps = [part.replace(b"\xaa", b"\x55") for part in junk]
    stream = b"".join(gaps[k] + sent[k].tobytes() for k in range(n)) + gaps[n]
    edges = sorted({0, *(min(cut, len(stream)) for cut in cuts), len(stream)})
    parser = FrameParser()
    found = [parser.feed(stream[a:b]) for a, b in pairwise(edges)]
    assert b"".join(part.tobytes() for part in found) == sent.tobytes()
    assert parser.skipped == sum(map(len, gaps[:n]))
    assert parser.pending == len(gaps[n])


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_damaged_frame_is_lost_alone_and_counted(data: st.DataObject) -> None:
    n = 20
    sent = frames(n, sequence=65530)
    bad = data.draw(st.sets(st.integers(1, n - 2), max_size=6))
    stream = bytearray(sent.tobytes())
    for k in bad:
        stream[k * SIZE + data.draw(st.integers(8, 103))] ^= 1 << data.draw(st.integers(0, 7))
    found = FrameParser().feed(bytes(stream))
    good = [k for k in range(n) if k not in bad]
    assert found.tobytes() == sent[good].tobytes()
    clock = FrameClock(ticks_per_second=64e6, wraps=2**32)
    seconds, lost = clock.advance(
        found["sequence"].astype(np.int64), found["ticks"].astype(np.int64)
    )
    assert lost.sum() == len(bad)
    np.testing.assert_allclose(seconds, np.array(good) * 0.016, atol=1e-12)


@given(
    start=st.integers(0, 2**32 - 1),
    gap=st.integers(0, 20_000),
    batch=st.integers(2, 50),
)
@settings(max_examples=80, deadline=None)
def test_the_clock_runs_on_over_wraps_and_long_gaps(start: int, gap: int, batch: int) -> None:
    # 20000 frames are 320 s, in which the 32-bit counter wraps more than four times.
    index = np.r_[0:100, 100 + gap : 200 + gap]
    ticks = (start + TICKS * index.astype(np.int64)) % 2**32
    clock = FrameClock(ticks_per_second=64e6, wraps=2**32)
    parts = [
        clock.advance(index[k : k + batch] % 65536, ticks[k : k + batch])
        for k in range(0, len(index), batch)
    ]
    seconds, lost = (np.concatenate(part) for part in zip(*parts, strict=True))
    np.testing.assert_allclose(seconds, index * 0.016, rtol=1e-12)
    assert lost.sum() == gap


def test_units_and_choice_of_the_imu(tmp_path: Path) -> None:
    sent = frames(50)
    path = tmp_path / "data.bin"
    path.write_bytes(b"\x01\x02" + sent.tobytes() + b"\xaa\x00")
    recording = read_recording(path, imu=3)
    expected = sent["imu"][:, 2].astype(float)
    np.testing.assert_allclose(recording.accel, expected[:, :3] * 9.80665 / 2048)
    np.testing.assert_allclose(recording.gyro, np.radians(expected[:, 3:] / 16.4))
    assert recording.device.serial_number == "IMU 3"
    assert not recording.complete
    assert recording.notes["cut"].startswith("2 bytes")
    parts = list(open_batches(path, imu=3, batch=7))
    np.testing.assert_array_equal(np.concatenate([p.accel for p in parts]), recording.accel)
    assert not any(part.complete for part in parts)
    for imu in (None, 0, 9):
        with pytest.raises(RecordingFormatError, match="--imu 1 to --imu 8"):
            read_recording(path, imu=imu)
