"""``emulator://mpu6050`` and ``imu-cal emulate mpu6050``: chip models in this process, or on a bus.

In this process the model and the driver share one clock, which may run at any speed; on an
emulated bus file any program can use the chip.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from drivers.address import Address
from drivers.chips import chips, get_chip, normal_name
from drivers.chips.base import Chip, Setup
from drivers.driver import Driver
from drivers.emulators.base import EmulatedSensor, Emulator, EmulatorOptions, make_sensor
from drivers.emulators.chips import resolve
from drivers.emulators.chips.base import ChipModel
from drivers.emulators.fuse_bus import FuseBus
from drivers.emulators.i2c_bus import EmulatedBus
from drivers.transports.i2c import HostClock, I2CDriver, setup_from_options

ANY_FIRMWARE = bytes(32)
"""What stands in for a maker's configuration file on an emulated chip, which takes any."""


def make_model(
    name: str, options: EmulatorOptions, *, clock: Callable[[], float] = time.monotonic
) -> ChipModel:
    """Return a chip's model, powered on now; ValueError if no chip has that name."""
    model, part = resolve(name)

    def source(rate: float) -> EmulatedSensor:
        return make_sensor(replace(options, rate=rate), default_rate=rate)

    return model(source, part=part, seed=options.seed, clock=clock)


def host_clock(speed: float) -> HostClock:
    """Return a clock that runs `speed` times as fast as ours; 0: it moves when somebody sleeps."""
    if speed > 0:
        return HostClock(lambda: time.monotonic() * speed, lambda wait: time.sleep(wait / speed))
    now = 0.0

    def sleep(wait: float) -> None:
        nonlocal now
        now += wait

    return HostClock(lambda: now, sleep)


def chip_emulators() -> dict[str, Emulator]:
    """Return an emulator for every part of every chip family."""
    out = {}
    for chip in chips().values():
        for part in (*chip.models.values(), *chip.aliases):
            name = normal_name(part)
            out[name] = Emulator(
                name,
                f"{part} on an emulated I2C bus (Linux, root)",
                partial(_driver, name),
                partial(_serve, name),
            )
    return out


def _driver(name: str, address: Address) -> Driver:
    more = ("accel_range", "gyro_range", "filter", "fifo")
    options = EmulatorOptions.from_address(address, *more)
    clock = host_clock(options.speed)
    chip = get_chip(name)
    setup = setup_from_options(address)
    setup(chip)  # a bad option is refused now
    bus = EmulatedBus({chip.addresses[0]: make_model(name, options, clock=clock.now)})

    def with_firmware(chip: Chip) -> Setup:
        return replace(setup(chip), firmware=ANY_FIRMWARE)

    return I2CDriver(
        address.text,
        connect=lambda: bus,
        place=chip.addresses[0],
        chip=name,
        setup=with_firmware,
        fifo=address.choice("fifo", ("on", "off"), "on") == "on",
        clock=None if options.speed == 1 else clock,
    )


def _serve(
    name: str,
    options: EmulatorOptions,
    announce: Callable[[str], None],
    stop: threading.Event,
) -> None:
    chip = get_chip(name)
    place = chip.addresses[0]
    clock = host_clock(options.speed or 1.0)
    bus = EmulatedBus({place: make_model(name, options, clock=clock.now)})
    with FuseBus(bus) as served:
        rate = f"&rate={options.rate:g}" if options.rate else ""
        announce(f"i2c://{served.path}/0x{place:02x}?chip={name}{rate}")
        stop.wait()
