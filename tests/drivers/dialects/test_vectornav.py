"""Expected bytes: the manual's own example sentences, and frames written out by hand."""

import struct

import numpy as np
import pytest

from calib.errors import AddressError
from drivers.dialects.vectornav import DIALECT, VectorNavParser, command, layout_of


def parser(**options: str) -> VectorNavParser:
    made = DIALECT.parser(options)
    assert isinstance(made, VectorNavParser)
    return made


def test_commands_have_the_manuals_checksums() -> None:
    assert command("VNWNV") == b"$VNWNV*57\r\n"
    assert command("VNRST") == b"$VNRST*4D\r\n"
    assert command("VNRFS") == b"$VNRFS*5F\r\n"


def test_imu_sentence() -> None:
    line = command(
        "VNIMU,+01.0640,-00.2531,+03.0614,+00.3000,-00.2000,-09.8066,+00.0100,-00.0200,+00.0300,"
        "+24.5,+101.325"
    )
    samples = parser().feed(line * 2)
    assert np.allclose(samples.accel[1], [0.3, -0.2, -9.8066])
    assert np.allclose(samples.gyro[1], [0.01, -0.02, 0.03])
    assert samples.temperature is not None
    assert samples.temperature[1] == pytest.approx(24.5)


@pytest.mark.parametrize(
    ("header", "length"),
    [
        # IMU: uncompensated magnetic field, acceleration, rate, temperature, pressure; attitude:
        # angles, matrix, field and acceleration in NED. A logger in the field names this header,
        # and 123 bytes after the first.
        ("fa14 3e00 3a00", 124),
        ("fa01 2900", 38),
        ("fa01 2105", 58),
    ],
)
def test_layouts(header: str, length: int) -> None:
    layout = layout_of(bytes.fromhex(header))
    assert layout is not None
    assert layout.length == length


@pytest.mark.parametrize("header", ["fa00", "fa08 0100", "fa01 0000", "fa01 0080", "fa"])
def test_layouts_that_are_not_known(header: str) -> None:
    assert layout_of(bytes.fromhex(header)) is None


def binary(payload: bytes, header: str) -> bytes:
    body = bytes.fromhex(header)[1:] + payload
    crc = 0
    for byte in body:
        for bit in range(7, -1, -1):
            crc = ((crc << 1) ^ (0x1021 if (crc >> 15 ^ byte >> bit) & 1 else 0)) & 0xFFFF
    return b"\xfa" + body + struct.pack(">H", crc)


def test_binary_frame_with_both_signals_takes_the_compensated() -> None:
    # Common group: time since start-up (bit 0), rate (5), acceleration (8), IMU (9).
    payload = struct.pack("<Q12f", 1_500_000_000, *range(12))
    frame = binary(payload, "fa01 2103")
    samples = parser().feed(frame)
    assert samples.gyro.tolist() == [[0, 1, 2]]
    assert samples.accel.tolist() == [[3, 4, 5]]
    assert samples.ticks is not None
    assert samples.ticks[0] == pytest.approx(1.5)
    raw = parser(signal="uncompensated").feed(frame)
    assert raw.accel.tolist() == [[6, 7, 8]]
    assert raw.gyro.tolist() == [[9, 10, 11]]


def test_replies_between_binary_frames() -> None:
    frame = binary(struct.pack("<6f", *range(6)), "fa01 2001")
    made = parser()
    samples = made.feed(frame + command("VNRRG,25,1,0,0,0,1,0,0,0,1,0,0,0.5") + frame)
    assert len(samples) == 2
    assert samples.lost.tolist() == [0, 0]
    reply = made.replies[0]
    assert reply.key == "VNRRG,25"
    assert reply.values[-1] == 0.5
    assert not made.counters


def test_frames_that_are_not_finite_are_counted() -> None:
    good = binary(struct.pack("<6f", *range(6)), "fa01 2001")
    bad = binary(struct.pack("<6f", 0, 0, float("nan"), 0, 0, 0), "fa01 2001")
    made = parser()
    assert made.feed(good + bad + good).lost.tolist() == [0, 1]
    assert made.feed(good + bad).lost.tolist() == [0]
    assert len(made.feed(bad)) == 0
    assert made.feed(good).lost.tolist() == [2]
    assert made.counters == {"invalid_samples": 3}


def test_unknown_signal() -> None:
    with pytest.raises(AddressError, match="any, compensated or uncompensated"):
        parser(signal="best")
