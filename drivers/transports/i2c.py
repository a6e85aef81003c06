"""``i2c://BUS/ADDRESS?chip=...``: IMU chips on an I2C bus (Linux).

The FIFO pattern: every few milliseconds read the count, cut it to whole samples, fetch them in one
burst, then look at the overflow bit. An overflow empties the FIFO; what it cost is reckoned from
host time and counted in ``lost``. A thread does this, so that a consumer that stalls (on a disk,
say) costs nothing: an MPU-6050's FIFO holds 73 samples.

Opening does not reset the chip: user registers that were flashed since power-on stay in force.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors import (
    DeviceLostError,
    DeviceNotFoundError,
    DriverError,
    WrongDeviceError,
)
from calib.gravity import STANDARD_GRAVITY
from calib.recording import Clock, DeviceInfo, Recording, join
from drivers.address import Address
from drivers.chips import chips, get_chip, normal_name
from drivers.chips.base import NO_SAMPLES, Bus, Chip, Device, Samples, Setup
from drivers.driver import Driver
from drivers.i2c_scan import ask_identity, identify
from drivers.sample_times import DeviceTimes, SampleTimes
from drivers.smbus import SmbusBus
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
    clock : HostClock or None
        None is the machine's own; on another one, samples are read by whoever calls `read`.
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
        self.background = clock is None
        """Whether a thread reads; who uses `device` sets it to False before `open`."""
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._arrived = threading.Event()
        self._queue: deque[Recording] = deque()
        self._failure: BaseException | None = None
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
            if self.background:
                self._start_thread()
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
        self._uses_fifo = bool(self._fifo and chip.fifo_size)
        if self._uses_fifo:
            chip.start_fifo(device)
        # A FIFO is read when a few samples wait, well before it is half full.
        self._pause = 1 / (4 * rate)
        if self._uses_fifo:
            depth = chip.fifo_size / chip.fifo_frame / rate
            self._pause = min(max(0.01, 8 / rate), depth / 4, 0.1)
        age = self._pause / 2
        if self._uses_fifo:
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
        value, part = ask_identity(bus, self._place, chip)
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
        self._stop.set()
        if self._thread is not None:
            self._thread.join(5)
            self._thread = None
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
        if self.background:
            if not self._queue:
                self._arrived.wait(timeout)
            self._arrived.clear()
            batches = [self._queue.popleft() for _ in range(len(self._queue))]
            if not batches and self._failure is not None:
                raise self._failure
            return join(batches) if batches else None
        deadline = self._clock.now() + timeout
        while True:
            batch = self._next()
            left = deadline - self._clock.now()
            if batch is not None or left <= 0:
                return batch
            self._clock.sleep(min(self._pause, left))

    def _start_thread(self) -> None:
        self._stop.clear()
        self._arrived.clear()
        self._queue.clear()
        self._failure = None
        self._thread = threading.Thread(target=self._pump, name="i2c reader", daemon=True)
        self._thread.start()

    def _pump(self) -> None:
        while not self._stop.is_set():
            try:
                batch = self._next()
            except DriverError as error:
                self._failure = error
                self._arrived.set()
                return
            if batch is not None:
                self._queue.append(batch)
                self._arrived.set()
            elif not self._uses_fifo:
                self._stop.wait(self._pause)

    def _next(self) -> Recording | None:
        """Return what waits now, if anything."""
        try:
            samples, now = self._fetch()
        except OSError as error:
            if isinstance(error, DriverError):
                raise
            raise DeviceLostError(
                f"{self.address}: the chip stopped answering ({error.strerror}); check its "
                "power and cable"
            ) from error
        return self._recording(samples, now) if len(samples) else None

    def _fetch(self) -> tuple[Samples, float]:
        chip, device, clock = self.chip, self.device, self._clock
        if not self._uses_fifo:
            if not chip.ready(device):
                return NO_SAMPLES, 0.0
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
