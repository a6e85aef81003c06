"""Every registered chip, byte for byte: `exchanges/NAME.txt` says what is written and answered.

A line is ``W REGISTER BYTES`` (written), ``R REGISTER -> BYTES`` (read), or one of

- ``open ACCEL GYRO RATE [FILTER]``: the driver is opened with these settings (g, °/s, Hz, Hz);
- ``read``: a batch is read; ``= ax ay az gx gy gz temperature`` lines follow with its samples in
  counts and °C, and ``lost N`` or ``overflow``;
- ``close``.

``00*1022`` stands for as many bytes.

Everything after ``#`` is a remark. A transaction that is not in the file, and one that is left
over, fail.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
import pytest

from drivers.chips import chips
from drivers.chips.base import Setup
from drivers.emulators.i2c_chips import host_clock
from drivers.transports.i2c import I2CDriver

FOLDER = Path(__file__).parent / "exchanges"
FIRMWARE = bytes(range(64))


class ScriptedBus:
    """Answers as the script says, and holds every transaction against it."""

    def __init__(self, place: int) -> None:
        self.place = place
        self.script: deque[tuple[str, int, bytes]] = deque()

    def _next(self, kind: str, address: int, register: int, data: object) -> bytes:
        assert address == self.place
        assert self.script, f"not in the script: {kind} {register:02X} {data}"
        expected_kind, expected_register, answer = self.script.popleft()
        assert (kind, register) == (expected_kind, expected_register), f"{kind} {register:02X}"
        return answer

    def read(self, address: int, register: int, count: int) -> bytes:
        answer = self._next("R", address, register, count)
        assert len(answer) == count, f"R {register:02X}: {count} bytes asked"
        return answer

    def write(self, address: int, register: int, data: bytes) -> None:
        expected = self._next("W", address, register, data.hex(" "))
        assert data == expected, f"W {register:02X}: {data.hex(' ')}, not {expected.hex(' ')}"

    def close(self) -> None:
        pass


def steps(path: Path) -> list[tuple[str, list[str], list[str]]]:
    """Return (action, its words, its transactions and expectations) in order."""
    out: list[tuple[str, list[str], list[str]]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        text = line.split("#")[0].strip()
        if not text:
            continue
        first, *words = text.split()
        if first in ("open", "read", "close"):
            out.append((first, words, []))
        else:
            out[-1][2].append(text)
    return out


def load(bus: ScriptedBus, lines: list[str]) -> list[str]:
    """Put the transactions into the bus and return the expectations."""
    rest = []
    for line in lines:
        kind, *words = line.split()
        if kind in "WR":
            data = b"".join(map(octets, words[1:]))
            bus.script.append((kind, int(words[0], 16), data))
        else:
            rest.append(line)
    return rest


def octets(word: str) -> bytes:
    """Return the bytes of ``5A``, of ``00*1022``, or of the arrow."""
    value, _, count = word.partition("*")
    return b"" if value == "->" else bytes.fromhex(value) * int(count or 1)


@pytest.mark.parametrize("name", chips())
def test_exchange(name: str) -> None:
    path = FOLDER / f"{name}.txt"
    assert path.exists(), f"add {path.name}: what {name} is told and answers, byte for byte"
    chip = chips()[name]
    bus = ScriptedBus(chip.addresses[0])
    (first, words, lines), *others = steps(path)
    assert first == "open"
    accel, gyro, rate, *bandwidth = map(float, words)
    setup = Setup(accel, gyro, rate, *bandwidth, **{"firmware": FIRMWARE})
    driver = I2CDriver(
        name,
        connect=lambda: bus,
        place=chip.addresses[0],
        chip=name,
        setup=lambda _: setup,
        clock=host_clock(0),
    )
    assert load(bus, lines) == []
    driver.open()
    assert not bus.script, f"left over after open: {bus.script}"
    assert {a for a, _, _ in others} == {"read", "close"}
    for action, _, lines in others:
        expected = load(bus, lines)
        if action == "close":
            driver.close()
        else:
            check(driver, expected)
        assert not bus.script, f"left over after {action}: {bus.script}"


def check(driver: I2CDriver, expected: list[str]) -> None:
    samples = driver.chip.read_fifo(driver.device)
    rows = [[float(w) for w in line.split()[1:]] for line in expected if line.startswith("=")]
    got = np.hstack([samples.accel, samples.gyro]).tolist()
    assert got == [row[:6] for row in rows]
    if rows:
        assert samples.temperature is not None
        assert samples.temperature == pytest.approx([row[6] for row in rows], abs=0.01)
    lost = next((int(line.split()[1]) for line in expected if line.startswith("lost")), 0)
    assert samples.lost == lost
    assert samples.overflow == ("overflow" in expected)


def test_no_exchange_is_of_a_chip_that_is_gone() -> None:
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(chips())
