"""Expected bytes, written out by hand from the protocol's table."""

import numpy as np
import pytest

from drivers.dialects.base import DEGREE
from drivers.dialects.witmotion import (
    SAVE,
    UNLOCK,
    WitMotionParser,
    read_register,
    write_register,
)

# 51: 0.5 g, -1 g, 2 g, 25.00 °C; 52: 1000, -500, 0.061 dps; sums are of the first ten bytes.
ACCEL = bytes.fromhex("5551 0004 00f8 0010 c409 7f")
GYRO = bytes.fromhex("5552 0040 00e0 0100 c409 95")
ANGLE = bytes.fromhex("5553 0000 0000 0000 0000 a8")
REPLY = bytes.fromhex("555f 0100 0200 ffff 0000 b5")


def feed(data: bytes) -> tuple[WitMotionParser, list[int]]:
    parser = WitMotionParser()
    return parser, parser.feed(data).lost.tolist()


def test_expected_bytes() -> None:
    parser = WitMotionParser()
    samples = parser.feed(ACCEL + GYRO)
    assert np.allclose(samples.accel / 9.80665, [[0.5, -1.0, 2.0]], rtol=1e-15)
    assert np.allclose(samples.gyro / DEGREE, [[1000.0, -500.0, 2000 / 32768]], rtol=1e-12)
    assert samples.temperature is not None
    assert samples.temperature[0] == pytest.approx(25.0)
    assert not parser.counters


def test_commands() -> None:
    assert UNLOCK.hex() == "ffaa6988b5"
    assert SAVE.hex() == "ffaa000000"
    assert write_register(0x05, -2).hex() == "ffaa05feff"
    assert read_register(0x05).hex() == "ffaa270500"


def test_a_register_reply_between_the_halves_does_not_part_them() -> None:
    parser, lost = feed((ACCEL + REPLY + GYRO) * 2)
    assert lost == [0, 0]
    assert parser.replies[0].values == (1, 2, -1, 0)


@pytest.mark.parametrize("size", [1, 5, 11, 13, 22, 40])
def test_chunks_do_not_matter(size: int) -> None:
    data = (ACCEL + GYRO + ANGLE) * 20
    data = data[:200] + b"\x55\x51\x00" + data[217:]
    whole = WitMotionParser()
    want = whole.feed(data)
    parser = WitMotionParser()
    lost = [parser.feed(data[k : k + size]).lost for k in range(0, len(data), size)]
    assert sum(map(len, lost)) == len(want)
    assert np.concatenate(lost).sum() == want.lost.sum()
    parser.finish()
    whole.finish()
    assert parser.counters == whole.counters


def test_halves_are_never_borrowed() -> None:
    cycle = ACCEL + GYRO + ANGLE
    # The gyroscope's half of one cycle and the accelerometer's of the next are gone.
    parser, lost = feed(cycle * 3 + ACCEL + GYRO[11:] + ANGLE + GYRO + ANGLE + cycle * 3)
    assert lost == [0, 0, 0, 1, 0, 0] or lost == [0, 0, 0, 2, 0, 0]
    assert parser.counters["unpaired_halves"] == 2


def test_damage_to_another_frame_loses_no_sample() -> None:
    cycle = ACCEL + GYRO + ANGLE
    broken = ACCEL + GYRO + ANGLE[:5] + b"\x01" + ANGLE[6:]
    parser, lost = feed(cycle * 4 + broken + cycle * 4)
    assert lost == [0] * 9
    assert parser.counters == {"skipped_bytes": 11, "damaged_frames": 1}


def test_a_damaged_cycle_is_counted() -> None:
    cycle = ACCEL + GYRO + ANGLE
    _, lost = feed(cycle * 4 + bytes(33) + bytes(33) + cycle * 4)
    assert lost == [0, 0, 0, 0, 2, 0, 0, 0]
