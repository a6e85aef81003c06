"""Readers of a pty, flat out: what is usual, and ours, in one run on one machine.

Another process writes prepared bytes as fast as the kernel takes them. CPU time is that of the
reading process alone, all its threads. The last rows show what damage costs: every hundredth line
or frame has a flipped byte.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import select
import struct
import sys
import time
import tty
from collections.abc import Callable

import numpy as np

from drivers.dialects.framing import crc16_ccitt
from drivers.dialects.vectornav import binary_frames
from drivers.transports import make_driver, open_driver

HEADER = bytes.fromhex("fa01 2101")
"""VectorNav binary: time since start-up, rate, acceleration: 38 bytes."""
FRAME = 38
ITEMS = 20_000
TEXT = "dialect=text&columns=t,ax,ay,az,gx,gy,gz&time_unit=us&accel_unit=m/s^2&gyro_unit=rad/s"
TABLE = [int(crc16_ccitt(np.array([[k]], np.uint8))[0]) for k in range(256)]


def text_block(*, damaged: bool) -> bytes:
    generator = np.random.default_rng(0)
    values = generator.normal(scale=5.0, size=(ITEMS, 6))
    lines = [
        f"{k * 3:09d},{a:.5f},{b:.5f},{c:.5f},{d:.5f},{e:.5f},{f:.5f}\n".encode()
        for k, (a, b, c, d, e, f) in enumerate(values.tolist())
    ]
    if damaged:
        for k in range(50, ITEMS, 100):
            lines[k] = lines[k][:30] + b"\xb7" + lines[k][31:]
    return b"".join(lines)


def binary_block(*, damaged: bool) -> bytes:
    generator = np.random.default_rng(0)
    payload = np.zeros((ITEMS, 32), np.uint8)
    payload[:, :8] = (np.arange(ITEMS, dtype="<u8")[:, None] * 3000).view(np.uint8)
    payload[:, 8:] = generator.normal(size=(ITEMS, 6)).astype("<f4").view(np.uint8)
    frames = binary_frames(HEADER, payload)
    if damaged:
        frames[50::100, 20] ^= 1
    return frames.tobytes()


# ---- what is usually written ----


def naive_readline(fd: int, until: float) -> int:
    count = 0
    buffer = b""
    while time.monotonic() < until:
        while b"\n" not in buffer:
            buffer += os.read(fd, 1)
        line, buffer = buffer.split(b"\n", 1)
        values = [float(word) for word in line.split(b",")]
        count += len(values) == 7
    return count


def waiting_then_float(fd: int, until: float) -> int:
    count, buffer = 0, b""
    while time.monotonic() < until:
        *lines, buffer = (buffer + os.read(fd, 65536)).split(b"\n")
        for line in lines:
            values = list(map(float, line.split(b",")))
            count += len(values) == 7
    return count


def bulk_numpy(fd: int, until: float) -> int:
    count, buffer = 0, b""
    while time.monotonic() < until:
        buffer += os.read(fd, 65536)
        if len(buffer) < 16384:
            continue
        end = buffer.rindex(b"\n") + 1
        text = buffer[:end].replace(b"\n", b",").decode()
        count += np.fromstring(text, sep=",").size // 7
        buffer = buffer[end:]
    return count


def bytewise(fd: int, until: float) -> int:
    count, frame = 0, bytearray()
    while time.monotonic() < until:
        for byte in os.read(fd, 65536):
            if not frame and byte != 0xFA:
                continue
            frame.append(byte)
            if len(frame) == FRAME:
                crc = 0
                for value in frame[1:]:
                    crc = (crc << 8 & 0xFFFF) ^ TABLE[crc >> 8 ^ value]
                if crc == 0:
                    struct.unpack("<Q6f", frame[4:36])
                    count += 1
                frame.clear()
    return count


def buffered(fd: int, until: float) -> int:
    count, buffer = 0, b""
    while time.monotonic() < until:
        buffer += os.read(fd, 65536)
        place = 0
        while len(buffer) - place >= FRAME:
            if buffer[place] != 0xFA:
                place += 1
                continue
            crc = 0
            for value in buffer[place + 1 : place + FRAME]:
                crc = (crc << 8 & 0xFFFF) ^ TABLE[crc >> 8 ^ value]
            if crc == 0:
                struct.unpack_from("<Q6f", buffer, place + 4)
                count += 1
            place += FRAME
        buffer = buffer[place:]
    return count


# ---- the rig ----


def write_forever(master: int, block: bytes) -> None:
    view = memoryview(block)
    try:
        while True:
            sent = 0
            while sent < len(view):
                sent += os.write(master, view[sent : sent + 65536])
    except OSError:
        return


def measure(block: bytes, read: Callable[[str, float], int], seconds: float) -> tuple[float, float]:
    """Return items a second and CPU microseconds an item."""
    master, slave = os.openpty()
    tty.setraw(slave)
    writer = multiprocessing.get_context("fork").Process(
        target=write_forever, args=(master, block), daemon=True
    )
    writer.start()
    try:
        begin, cpu = time.monotonic(), time.process_time()
        count = read(os.ttyname(slave), begin + seconds)
        return count / (time.monotonic() - begin), (time.process_time() - cpu) / count * 1e6
    finally:
        writer.terminate()
        writer.join()
        os.close(master)
        os.close(slave)


def by_descriptor(read: Callable[[int, float], int]) -> Callable[[str, float], int]:
    def run(path: str, until: float) -> int:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            select.select([fd], [], [], 1.0)
            return read(fd, until)
        finally:
            os.close(fd)

    return run


def ours(options: str, tally: dict[str, int]) -> Callable[[str, float], int]:
    def run(path: str, until: float) -> int:
        count = 0
        with open_driver(f"serial://{path}?{options}") as driver:
            while time.monotonic() < until:
                batch = driver.read(0.1)
                count += len(batch) if batch is not None else 0
            tally.update(driver.counters, samples=count)
        return count

    return run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3.0, help="for each reader")
    parser.add_argument("--data", help="not used: the bytes are made here")
    seconds = parser.parse_args().seconds
    make_driver(f"serial://none?{TEXT}")  # imports are not what is measured
    text, binary = text_block(damaged=False), binary_block(damaged=False)
    tallies: dict[str, dict[str, int]] = {"text": {}, "binary": {}}
    rows: list[tuple[str, bytes, Callable[[str, float], int]]] = [
        ("text: a byte at a time, split, float", text, by_descriptor(naive_readline)),
        ("text: what is waiting, then float", text, by_descriptor(waiting_then_float)),
        ("text: bulk numpy.fromstring", text, by_descriptor(bulk_numpy)),
        ("**text: imu-cal**", text, ours(TEXT, {})),
        ("binary: byte by byte, Python CRC", binary, by_descriptor(bytewise)),
        ("binary: buffered, CRC per frame", binary, by_descriptor(buffered)),
        ("**binary: imu-cal**", binary, ours("dialect=vectornav", {})),
        ("**text, 1 % damaged: imu-cal**", text_block(damaged=True), ours(TEXT, tallies["text"])),
        (
            "**binary, 1 % damaged: imu-cal**",
            binary_block(damaged=True),
            ours("dialect=vectornav", tallies["binary"]),
        ),
    ]
    print(f"{len(text) // ITEMS}-byte lines, {FRAME}-byte frames, {os.cpu_count()} cores, ", end="")
    print(f"load {os.getloadavg()[0]:.1f}\n")
    print("| reader | items/s | CPU µs per item |\n|---|---:|---:|")
    for name, block, read in rows:
        rate, cpu = measure(block, read, seconds)
        print(f"| {name} | {rate:,.0f} | {cpu:.2f} |", flush=True)
    failed = False
    print()
    for kind, damaged in (("text", "damaged_lines"), ("binary", "damaged_frames")):
        tally = tallies[kind]
        share = tally[damaged] / (tally["samples"] + tally[damaged])
        print(f"{kind}: {share:.3%} of the items were dropped, 1 % were damaged")
        failed |= not 0.009 < share < 0.011
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
