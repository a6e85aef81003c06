"""``i2c://BUS/ADDRESS?chip=...``: IMU chips on an I2C bus (Linux).

The FIFO pattern: every few milliseconds read the count, cut it to whole samples, fetch them in one
burst, then look at the overflow bit. An overflow empties the FIFO; what it cost is reckoned from
host time and counted in ``lost``. Opening does not reset the chip: user registers that were
flashed since power-on stay in force.
"""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors import (
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    DevicePermissionError,
    DriverError,
    WrongDeviceError,
)
from calib.recording import Clock, DeviceInfo, Recording
from calib.types import FloatArray, IntArray
from drivers.address import Address
from drivers.chips import chips, get_chip, normal_name
from drivers.chips.base import STANDARD_GRAVITY, Bus, Chip, Device, Samples, Setup
from drivers.driver import Driver
from drivers.transports.base import Transport

OPTIONS = ("chip", "rate", "accel_range", "gyro_range", "filter", "fifo", "config_file")
DEGREE = math.pi / 180


@dataclass(frozen=True)
class HostClock:
    """How a driver sees time pass; an emulator may run on another one."""

    now: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


class I2CDriver(Driver):
    """An IMU chip on an I2C bus.

    Parameters
    ----------
    address : str
        As the user wrote it, for messages.
    connect : callable
        Opens the bus; it is called by `open`.
    place : int
        The chip's address on it, 0x68 to 0x6B.
    chip : str
        A family's or a part's name, or ``auto`` for whatever identifies itself.
    setup : callable
        Returns the `Setup` for a chip; ValueError if the chip cannot do it.
    fifo : bool
        Through the FIFO (the default), or one burst of the data registers per sample.
    """

    def __init__(
        self,
        address: str,
        *,
        connect: Callable[[], Bus],
        place: int,
        chip: str,
        setup: Callable[[Chip], Setup],
        fifo: bool = True,
        clock: HostClock | None = None,
    ) -> None:
        super().__init__(address)
        self._connect = connect
        self._place = place
        self._wanted = chip
        self._make_setup = setup
        self._fifo = fifo
        self._clock = clock or HostClock()
        self._info = DeviceInfo(chip="" if chip == "auto" else chip)
        self._device: Device | None = None
        self._chip: Chip | None = None

    @property
    def info(self) -> DeviceInfo:
        return self._info

    @property
    def device(self) -> Device:
        """The open chip, for those who read and write its registers."""
        if self._device is None:
            raise ValueError(f"{self.address} is not open")
        return self._device

    @property
    def chip(self) -> Chip:
        """The open chip's family."""
        if self._chip is None:
            raise ValueError(f"{self.address} is not open")
        return self._chip

    def _open(self) -> None:
        bus = self._connect()
        try:
            self._start(bus)
        except OSError as error:
            bus.close()
            if isinstance(error, DriverError):
                raise
            raise DeviceNotFoundError(
                f"{self.address}: nothing answers at 0x{self._place:02X} ({error.strerror}); check "
                "wiring, power and pull-ups, or look with `imu-cal devices`"
            ) from error
        except BaseException:
            bus.close()
            raise

    def _start(self, bus: Bus) -> None:
        part, chip = self._identify(bus)
        device = Device(bus, self._place, bank_select=chip.bank_select, sleep=self._clock.sleep)
        setup = self._make_setup(chip)
        chip.configure(device, setup)
        self._clock.sleep(chip.start_up)
        self._device, self._chip = device, chip
        rate = chip.nearest_rate(setup.rate)
        accel, gyro = (
            chip.accel_sensitivity(setup.accel_range),
            chip.gyro_sensitivity(setup.gyro_range),
        )
        self._info = DeviceInfo(
            chip=part,
            accel_full_scale=accel.full_scale * STANDARD_GRAVITY,
            gyro_full_scale=gyro.full_scale * DEGREE,
            accel_lsb=STANDARD_GRAVITY / accel.counts,
            gyro_lsb=DEGREE / gyro.counts,
            rate=rate,
        )
        self._begin_stream(device, chip)

    def _begin_stream(self, device: Device, chip: Chip) -> None:
        rate = self._info.rate
        assert rate is not None
        if self._fifo and chip.fifo_size:
            chip.start_fifo(device)
        # A FIFO is read when a few samples wait, well before it is half full.
        self._pause = 1 / (4 * rate)
        if self._fifo and chip.fifo_size:
            depth = chip.fifo_size / chip.fifo_frame / rate
            self._pause = min(max(0.01, 8 / rate), depth / 4, 0.1)
        age = self._pause / 2
        if self._fifo and chip.fifo_size:
            age = 0.5 / rate
        elif chip.ready(device):
            chip.sample(device)  # of unknown age: the next one comes when it is new
        self._times = SampleTimes(rate, self._clock.now(), age=age)
        self._ticks = DeviceTimes(rate, chip.clock_period)
        self._lost = 0

    def restart_stream(self, settle: float) -> None:
        """Drop what waits, and begin anew at time 0 after `settle` seconds."""
        self._clock.sleep(settle)
        self._begin_stream(self.device, self.chip)

    def _identify(self, bus: Bus) -> tuple[str, Chip]:
        if self._wanted == "auto":
            answers = identify(bus, self._place)
            if answers:
                return answers[0]
            raise WrongDeviceError(
                f"{self.address}: something answers at 0x{self._place:02X}, but it is no IMU that "
                f"imu-cal knows ({', '.join(chips())})"
            )
        chip = get_chip(self._wanted)
        value, part = _ask_identity(bus, self._place, chip)
        first = next(iter(chip.models.values()))
        names = (part, *(chip.aliases if part == first else ()))
        if normal_name(self._wanted) in map(normal_name, names):
            return part, chip
        answers = identify(bus, self._place)
        expected = " or ".join(f"0x{v:02X} ({p})" for v, p in chip.models.items())
        advice = "nothing that imu-cal knows; a clock or another chip may sit at this address"
        if answers:
            name = normal_name(answers[0][0])
            advice = f"it is an {answers[0][0]}: use chip={name} or chip=auto"
        raise WrongDeviceError(
            f"{self.address}: identity register 0x{chip.identity.address:02X} reads 0x{value:02X}, "
            f"expected {expected}; {advice}"
        )

    def _close(self) -> None:
        device, chip = self._device, self._chip
        self._device = None
        if device is None or chip is None:
            return
        try:
            chip.sleep(device)
        except OSError:
            pass  # it is gone already, and sleeps for good
        finally:
            device.bus.close()

    def _read(self, timeout: float) -> Recording | None:
        clock = self._clock
        deadline = clock.now() + timeout
        while True:
            try:
                samples, now = self._fetch()
            except OSError as error:
                if isinstance(error, DriverError):
                    raise
                raise DeviceLostError(
                    f"{self.address}: the chip stopped answering ({error.strerror}); check its "
                    "power and cable"
                ) from error
            if len(samples):
                return self._recording(samples, now)
            left = deadline - clock.now()
            if left <= 0:
                return None
            clock.sleep(min(self._pause, left))

    def _fetch(self) -> tuple[Samples, float]:
        chip, device, clock = self.chip, self.device, self._clock
        if not (self._fifo and chip.fifo_size):
            if not chip.ready(device):
                return Samples(np.empty((0, 3), np.int16), np.empty((0, 3), np.int16), None), 0.0
            now = clock.now()
            self._lost += self._times.missing(now)
            return chip.sample(device), now
        wait = self._times.last_read + self._pause - clock.now()
        if wait > 0:
            clock.sleep(wait)
        now = clock.now()
        self._times.last_read = now
        samples = chip.read_fifo(device)
        if samples.overflow:
            self.counters["fifo_overflows"] += 1
            chip.start_fifo(device)
            self._lost += self._times.restart(clock.now())
        if samples.lost:
            self.counters["fifo_overflows"] += 1
        self._lost += samples.lost
        return samples, now

    def _recording(self, samples: Samples, now: float) -> Recording:
        setup = self._info
        assert setup.accel_lsb is not None
        assert setup.gyro_lsb is not None
        if samples.ticks is not None:
            times, lost = self._ticks.take(samples.ticks, now)
            clock: Clock = "device"
        else:
            lost = np.zeros(len(samples), np.int64)
            lost[0] = self._lost
            times = self._times.take(len(samples), self._lost, now)
            clock = "host"
        self._lost = 0
        return Recording(
            time=times,
            accel=np.multiply(samples.accel, setup.accel_lsb, dtype=np.float64),
            gyro=np.multiply(samples.gyro, setup.gyro_lsb, dtype=np.float64),
            clock=clock,
            temperature=samples.temperature,
            lost=lost,
            device=self._info,
        )


class SampleTimes:
    """Sample numbers turned into times: the device's steady rate, locked to host time.

    The last sample of a read has a known mean `age`: half an interval where a FIFO's count is
    read, half a polling pause where a data-ready bit is watched. ``now - age`` observes its time.
    A Kalman filter over (time of the last sample, interval) follows these observations.
    """

    def __init__(self, rate: float, now: float, *, age: float) -> None:
        self.age = age
        self.interval = 1 / rate
        self.nominal = 1 / rate
        self.last_read = now
        self._origin = now
        self._last = 0.0
        self._started = False
        # Of the estimates: an IMU's oscillator is within a few per cent of its nominal rate.
        self._variance = np.diag([(2 * age) ** 2, (0.03 / rate) ** 2])
        # Of an observation: the age is even over its range, and reads are late by scheduling.
        self._noise = (2 * age) ** 2 / 12 + 2e-4**2

    def take(self, count: int, lost: int, now: float) -> FloatArray:
        """Return the times of the next `count` samples, `lost` samples after the one before."""
        observed = now - self._origin - self.age
        steps = count + lost
        if not self._started:
            self._started = True
            self._last = observed - steps * self.interval
        predict = np.array([[1.0, steps], [0.0, 1.0]])
        variance = predict @ self._variance @ predict.T
        # The rate drifts with temperature, by about 1e-6 of itself a second.
        variance[1, 1] += (1e-6 * self.interval) ** 2 * steps * self.interval
        gain = variance[:, 0] / (variance[0, 0] + self._noise)
        error = observed - (self._last + steps * self.interval)
        self._variance = variance - np.outer(gain, variance[0])
        # Never backwards, however late a read was: at least half the nominal interval.
        step = max(self.interval + gain[0] * error / steps, self.nominal / 2)
        self.interval = min(
            max(self.interval + gain[1] * error, 0.9 * self.nominal), 1.1 * self.nominal
        )
        times: FloatArray = self._last + step * np.arange(lost + 1, steps + 1, dtype=np.float64)
        self._last += step * steps
        return times

    def restart(self, now: float) -> int:
        """Return how many samples an emptied FIFO lost between the last one and `now`."""
        if not self._started:
            return 0
        elapsed = now - self._origin - self._last
        return max(1, int(elapsed / self.interval))

    def missing(self, now: float) -> int:
        """Return how many samples went by unread, when one that is new is read at `now`."""
        if not self._started:
            return 0
        elapsed = now - self.age - self._origin - self._last
        return max(0, round(elapsed / self.interval) - 1)


class DeviceTimes:
    """The chip's own clock unwrapped, and the samples that it shows to be missing.

    Parameters
    ----------
    rate : float, Hz
        Samples and clock come from one oscillator, so that steps are whole intervals of it.
    period : float, s
        When the clock wraps around. Pauses longer than that are told apart by host time.
    """

    def __init__(self, rate: float, period: float) -> None:
        self._interval = 1 / rate
        self._period = period
        self._tick: float | None = None
        self._time = 0.0
        self._now = 0.0

    def take(self, ticks: FloatArray, now: float) -> tuple[FloatArray, IntArray]:
        """Return times from 0, and how many samples are missing before each, at host time `now`."""
        steps = np.diff(ticks, prepend=ticks[0] if self._tick is None else self._tick)
        steps = np.mod(steps, self._period)
        if self._tick is not None:
            rest = now - self._now - float(steps.sum())
            steps[0] += self._period * max(0, round(rest / self._period))
        times = self._time + np.cumsum(steps)
        lost = np.clip(np.rint(steps / self._interval) - 1, 0, None).astype(np.int64)
        self._tick, self._time, self._now = float(ticks[-1]), float(times[-1]), now
        return times, lost


# ---- who is there ----


def identify(bus: Bus, place: int) -> list[tuple[str, Chip]]:
    """Return the parts that could answer at an address, by their identity registers only.

    Raises
    ------
    OSError
        If nothing answers there.
    """
    found = []
    for chip in chips().values():
        if place in chip.addresses:
            _, part = _ask_identity(bus, place, chip)
            if part:
                found.append((part, chip))
    return found


def _ask_identity(bus: Bus, place: int, chip: Chip) -> tuple[int, str]:
    """Return what a chip's identity register reads, and the part that it stands for ('')."""
    register = chip.identity.address
    value = bus.read(place, register, 1)[0]
    part = chip.models.get(value, "")
    if part and register == 0 and _is_clock(bus, place):
        part = ""
    return value, part


def _is_clock(bus: Bus, place: int) -> bool:
    """Whether registers 0 to 6 read as a calendar: real-time clocks live at 0x68 too.

    A DS3231 at 24 s reads 0x24 from register 0 as a BMI270 does. Day of week, day and month are
    never zero in a clock; in the chips these registers are status bits and empty data.
    """
    data = bus.read(place, 0, 7)
    date, month = _bcd(data[4] & 0x3F), _bcd(data[5] & 0x1F)
    return 1 <= data[3] <= 7 and 1 <= date <= 31 and 1 <= month <= 12


def _bcd(byte: int) -> int:
    return 10 * (byte >> 4) + (byte & 0x0F)


@dataclass(frozen=True)
class Found:
    """What a scan saw: an IMU at an address, or (``problem``) why a bus could not be read."""

    bus: str
    address: int | None = None
    chip: str = ""
    url: str = ""
    problem: str = ""


def scan_buses(folder: Path = Path("/dev")) -> list[Found]:
    """Look for IMUs on every I2C bus, reading identity registers only; nothing is written."""
    if not sys.platform.startswith("linux"):
        return []
    out: list[Found] = []
    for path in sorted(folder.glob("i2c-[0-9]*"), key=lambda p: int(p.name[4:])):
        try:
            bus = SmbusBus(str(path))
        except DriverError as error:
            out.append(Found(str(path), problem=str(error)))
            continue
        try:
            out += _scan(bus, path)
        finally:
            bus.close()
    return out


def _scan(bus: Bus, path: Path) -> list[Found]:
    out = []
    for place in sorted({a for chip in chips().values() for a in chip.addresses}):
        try:
            answers = identify(bus, place)
        except OSError:
            continue
        name = path.name[4:] if str(path.parent) == "/dev" else str(path)
        for part, _ in answers:
            url = f"i2c://{name}/0x{place:02x}?chip={normal_name(part)}"
            out.append(Found(str(path), place, part, url))
    return out


# ---- the bus itself ----


class SmbusBus:
    """A Linux I2C adapter through smbus2.

    Plain I2C transactions where the adapter does them (``i2c_rdwr`` has no limit of 32 bytes);
    SMBus block calls where it does not.
    """

    def __init__(self, path: str) -> None:
        if not sys.platform.startswith("linux"):
            raise DeviceNotFoundError(
                f"{path}: I2C buses are reached on Linux only (this is {sys.platform}); record on "
                "a Linux board, or use a serial device"
            )
        import smbus2

        try:
            self._bus = smbus2.SMBus(path)
        except FileNotFoundError as error:
            raise DeviceNotFoundError(
                f"{path}: there is no such I2C bus; load the i2c-dev module and switch I2C on for "
                "this board, and see `ls /dev/i2c-*`"
            ) from error
        except PermissionError as error:
            raise DevicePermissionError(
                f"{path}: permission denied; join the i2c group (sudo usermod -aG i2c $USER, then "
                "log in again)"
            ) from error
        except OSError as error:
            raise DriverError(f"{path}: cannot open it as an I2C bus: {error.strerror}") from error
        self._message = smbus2.i2c_msg
        self._plain = bool(self._bus.funcs & smbus2.I2cFunc.I2C)

    def read(self, address: int, register: int, count: int) -> bytes:
        """Read registers after a repeated start."""
        if not self._plain:
            return self._read_blocks(address, register, count)
        write = self._message.write(address, [register])
        read = self._message.read(address, count)
        self._bus.i2c_rdwr(write, read)
        return bytes(read.buf[0:count])

    def _read_blocks(self, address: int, register: int, count: int) -> bytes:
        if count > 32:
            raise DriverError(
                f"this adapter has SMBus calls only, which read at most 32 bytes at once, not "
                f"{count} from a FIFO; add fifo=off to the address"
            )
        return bytes(self._bus.read_i2c_block_data(address, register, count))

    def write(self, address: int, register: int, data: bytes) -> None:
        """Write registers."""
        if self._plain:
            self._bus.i2c_rdwr(self._message.write(address, [register, *data]))
        else:
            self._bus.write_i2c_block_data(address, register, list(data))

    def lock(self, address: int) -> None:
        """Take one chip for this process, until the bus is closed.

        Raises
        ------
        DeviceBusyError
            If another process has it; the message names it.
        """
        import fcntl
        import os
        import struct

        assert self._bus.fd is not None
        request = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, address, 1, 0)
        try:
            fcntl.fcntl(self._bus.fd, fcntl.F_SETLK, request)
        except (BlockingIOError, PermissionError) as error:
            holder = struct.unpack("hhqqi4x", fcntl.fcntl(self._bus.fd, fcntl.F_GETLK, request))[4]
            raise DeviceBusyError(
                f"the chip at 0x{address:02X} is in use by process {holder}{_name(holder)}; end "
                "that first"
            ) from error

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()


def _name(pid: int) -> str:
    try:
        return f" ({Path(f'/proc/{pid}/comm').read_text(encoding='utf-8').strip()})"
    except OSError:
        return ""


# ---- addresses ----


def setup_from_options(address: Address) -> Callable[[Chip], Setup]:
    """Return the function that turns an address's options into a chip's setup."""
    rate = address.number("rate", 0.0)
    accel, gyro = address.number("accel_range", 0.0), address.number("gyro_range", 0.0)
    bandwidth = address.number("filter", 0.0) or None
    config_file = address.options.get("config_file")

    def setup(chip: Chip) -> Setup:
        wanted = Setup(
            accel or chip.default_ranges[0],
            gyro or chip.default_ranges[1],
            rate or chip.default_rate,
            bandwidth,
        )
        try:
            chip.check(wanted)
        except ValueError as error:
            raise address.error(str(error).replace("`", "")) from error
        if config_file is not None:
            try:
                wanted = replace(wanted, firmware=Path(config_file).read_bytes())
            except OSError as error:
                raise address.error(f"config_file: cannot read it: {error.strerror}") from error
        return wanted

    return setup


def _make(address: Address) -> Driver:
    address.check(OPTIONS)
    bus_name, slash, place_text = address.target.rpartition("/")
    if not slash or not re.fullmatch(r"0[xX][0-9a-fA-F]{1,2}|\d{1,3}", place_text):
        raise address.error(f"expected BUS/ADDRESS, as in {TRANSPORT.example}")
    place = int(place_text, 0)
    path = f"/dev/i2c-{bus_name}" if bus_name.isdigit() else bus_name
    chip = address.options.get("chip", "auto")
    setup = setup_from_options(address)
    if chip != "auto":
        try:
            family = get_chip(chip)
        except ValueError as error:
            raise address.error(str(error).replace("`", "")) from error
        if place not in family.addresses:
            names = " or ".join(f"0x{a:02X}" for a in family.addresses)
            raise address.error(f"{chip} lives at {names}, not at 0x{place:02X}")
        setup(family)

    def connect() -> Bus:
        bus = SmbusBus(path)
        try:
            bus.lock(place)
        except BaseException:
            bus.close()
            raise
        return bus

    return I2CDriver(
        address.text,
        connect=connect,
        place=place,
        chip=chip,
        setup=setup,
        fifo=address.choice("fifo", ("on", "off"), "on") == "on",
    )


TRANSPORT = Transport("i2c", "i2c://1/0x68?chip=mpu6050&rate=1000", _make)
