"""Expected bytes, written and answered, for every registered dialect; leftover bytes fail."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from drivers.dialects import dialects, mavlink, vectornav, witmotion
from drivers.stream import ByteSource, StreamDriver

HOST, DEVICE = ">", "<"
Script = list[tuple[str, bytes]]


class ScriptedSource(ByteSource):
    """Gives the device's bytes once the host has written exactly what stands before them."""

    def __init__(self, script: Script) -> None:
        self.script = list(script)
        self.written = b""
        self.time = 0.0

    def open(self) -> None:
        self.ended = False

    def close(self) -> None:
        assert not self.written, f"not expected: {self.written.hex(' ')}"
        assert not self.script, f"not asked for: {self.script}"

    def read(self, timeout: float) -> tuple[bytes, float | None]:
        if not self.script or self.script[0][0] == HOST:
            self.ended = not self.script
            return b"", None
        self.time += 0.6
        return self.script.pop(0)[1], self.time

    def write(self, data: bytes) -> None:
        self.written += data
        while self.written and self.script and self.script[0][0] == HOST:
            expected = self.script[0][1]
            assert self.written[: len(expected)] == expected[: len(self.written)]
            if len(self.written) < len(expected):
                return
            self.written = self.written[len(expected) :]
            self.script.pop(0)


def hexes(text: str) -> bytes:
    return bytes.fromhex(text)


def talk_witmotion(driver: StreamDriver) -> None:
    driver.send(witmotion.UNLOCK)
    driver.send(witmotion.write_register(0x05, 100))
    reply = driver.ask(witmotion.read_register(0x05), "registers", 1.0)
    assert reply.values == (100, 0, 0, 0)
    driver.send(witmotion.SAVE)


def talk_vectornav(driver: StreamDriver) -> None:
    reply = driver.ask(vectornav.command("VNRRG,25"), "VNRRG,25", 1.0)
    assert reply.values == (1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0)
    driver.ask(vectornav.command("VNWNV"), "VNWNV", 1.0)


def talk_mavlink(driver: StreamDriver) -> None:
    request = mavlink.param_request("CAL_ACC0_XOFF", system=1, component=1)
    reply = driver.ask(request, "PARAM_VALUE,CAL_ACC0_XOFF", 1.0)
    assert struct.unpack("<f", reply.values[0]) == (0.5,)
    assert reply.values[1] == 9


def talk_text(driver: StreamDriver) -> None:
    driver.send(b"start\n")


WIT_PAIR = hexes("5551 0004 00f8 0010 c409 7f 5552 0040 00e0 0100 c409 95")
VN_LINE = b"$VNMAR,+00.1,+00.2,+00.3,+01.0,+02.0,-09.8,+00.01,+00.02,+00.03*6B\r\n"
# Written by pymavlink. HIGHRES_IMU: 1 s, (1, 2, -9.5) m/s², (0.25, 0.5, 0.75) rad/s, 25 °C.
MAV_IMU = hexes(
    "fd3e000000010169000040420f00000000000000803f00000040000018c10000803e0000003f0000403f000000000000"
    "0000000000000000000000000000000000000000c841ff1f08cc"
)
MAV_ASK = hexes("fd11000000ffbe140000ffff010143414c5f414343305f584f4646f357")
MAV_ANSWER = hexes("fd1900000101011600000000003f0b00000043414c5f414343305f584f464600000009af7a")
EXCHANGES: dict[str, tuple[dict[str, str], Callable[[StreamDriver], None], Script, list[float]]] = {
    "witmotion": (
        {},
        talk_witmotion,
        [
            (HOST, hexes("ffaa6988b5")),
            (HOST, hexes("ffaa056400")),
            (HOST, hexes("ffaa270500")),
            (DEVICE, WIT_PAIR[:15]),
            (DEVICE, WIT_PAIR[15:] + hexes("555f 6400 0000 0000 0000 18")),
            (HOST, hexes("ffaa000000")),
        ],
        [0.5 * 9.80665, -9.80665, 2 * 9.80665],
    ),
    "vectornav": (
        {},
        talk_vectornav,
        [
            (HOST, b"$VNRRG,25*74\r\n"),
            (DEVICE, VN_LINE + b"$VNRRG,25,1,0,0,0,1,0,0,0,1,0,0,0*75\r\n"),
            (HOST, b"$VNWNV*57\r\n"),
            (DEVICE, b"$VNWNV*57\r\n"),
        ],
        [1.0, 2.0, -9.8],
    ),
    "mavlink": (
        {},
        talk_mavlink,
        [
            (HOST, MAV_ASK),
            (DEVICE, MAV_IMU + MAV_ANSWER),
        ],
        [1.0, 2.0, -9.5],
    ),
    "text": (
        {"columns": "ax,ay,az,gx,gy,gz", "accel_unit": "m/s^2", "gyro_unit": "rad/s"},
        talk_text,
        [(HOST, b"start\n"), (DEVICE, b"ready\n1,2,-9.5,0,0,0\n"), (DEVICE, b"1,2,-9.5,0,0,0\n")],
        [1.0, 2.0, -9.5],
    ),
}


def test_every_dialect_has_an_exchange() -> None:
    assert set(EXCHANGES) == set(dialects())


@pytest.mark.parametrize("name", EXCHANGES)
def test_exchange(name: str) -> None:
    options, talk, script, accel = EXCHANGES[name]
    source = ScriptedSource(script)
    with StreamDriver("scripted://", source, dialects()[name], options) as driver:
        talk(driver)
        batches = []
        while not driver.ended:
            batch = driver.read(0.0)
            if batch is not None:
                batches.append(batch)
        assert batches[0].accel[0].tolist() == pytest.approx(accel)
        assert not set(driver.counters) - {"incomplete_bytes"}


def test_leftover_bytes_fail() -> None:
    source = ScriptedSource([(HOST, b"abc"), (DEVICE, b"x")])
    with pytest.raises(AssertionError, match="not asked for"):
        source.close()
    source = ScriptedSource([])
    source.write(b"abc")
    with pytest.raises(AssertionError, match="not expected"):
        source.close()
