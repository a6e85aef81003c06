"""Every format that can be written reads back what was written."""

from pathlib import Path

import numpy as np
import pytest

from calib import DeviceInfo, Recording
from drivers.formats import (
    ArrowWriter,
    formats,
    open_batches,
    open_writer,
    read_recording,
    write_recording,
)

SUFFIXES = [s for f in formats().values() if f.writer is not None for s in f.suffixes]


def a_recording(n: int = 50, *, seed: int = 0, temperature: bool = True) -> Recording:
    rng = np.random.default_rng(seed)
    return Recording(
        time=np.cumsum(rng.uniform(0.005, 0.015, n)),
        accel=rng.normal(0, 10, (n, 3)),
        gyro=rng.normal(0, 1, (n, 3)),
        clock="device",
        temperature=rng.normal(25, 1, n) if temperature else None,
        lost=rng.integers(0, 3, n),
        device=DeviceInfo("MPU-6050", "A7", 19.6133, 4.36, 19.6133 / 32768, None, 100.0),
        notes={"operator": "Ann: 'at #3'", "long note": ' two\nlines, "quoted" '},
    )


def same(a: Recording, b: Recording) -> None:
    for name in ("time", "accel", "gyro", "temperature", "lost"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert (a.clock, a.device, a.complete) == (b.clock, b.device, b.complete)
    assert dict(a.notes) == dict(b.notes)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("temperature", [True, False])
def test_round_trip(tmp_path: Path, suffix: str, temperature: bool) -> None:
    recording = a_recording(temperature=temperature)
    path = tmp_path / f"log{suffix}"
    write_recording(recording, path)
    same(read_recording(path), recording)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_batches_join_to_the_whole(tmp_path: Path, suffix: str) -> None:
    recording = a_recording(1000)
    path = tmp_path / f"log{suffix}"
    write_recording(recording, path)
    parts = list(open_batches(path, batch=64))
    assert max(len(part) for part in parts) <= 64
    np.testing.assert_array_equal(np.concatenate([p.accel for p in parts]), recording.accel)
    np.testing.assert_array_equal(np.concatenate([p.lost for p in parts]), recording.lost)


def test_a_killed_arrow_file_reads_to_its_last_whole_batch(tmp_path: Path) -> None:
    whole, sizes, ends = a_recording(300), [0], []
    path = tmp_path / "log.arrow"
    with ArrowWriter(path) as writer:
        for at in range(0, 300, 100):
            writer.append(whole.slice(at, at + 100))
            writer.flush()
            ends.append(path.stat().st_size)
            sizes.append(at + 100)
    data = path.read_bytes()
    assert read_recording(path).complete
    for cut in range(ends[0], len(data), 97):
        path.write_bytes(data[:cut])
        recording = read_recording(path)
        expected = sizes[sum(end <= cut for end in ends)]
        assert len(recording) == expected
        assert not recording.complete
        np.testing.assert_array_equal(recording.gyro, whole.gyro[:expected])


@pytest.mark.parametrize("suffix", [".arrow", ".csv"])
def test_what_becomes_known_while_a_file_grows_is_read_back(tmp_path: Path, suffix: str) -> None:
    whole = read_recording(Path(__file__).parents[3] / "fixtures/bench.csv")
    path = tmp_path / f"log{suffix}"
    with open_writer(path) as writer:
        writer.append(whole.slice(0, 100))
        writer.remarks = {"bad checksums": "2"}
        writer.append(whole.slice(100, 200))
        writer.remarks = {"bad checksums": "3", "stray: bytes": "17"}
        writer.append(whole.slice(200, 300))
    again = read_recording(path)
    assert again.notes["bad checksums"] == "3"
    assert again.notes["stray: bytes"] == "17"
    np.testing.assert_array_equal(again.accel, whole.accel[:300])
