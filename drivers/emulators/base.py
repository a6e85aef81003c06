"""What every emulated chip and serial device shares: an imperfect sensor on a motion script.

An `EmulatedSensor` measures ``model.distort(true state) + noise`` along a script. Chips quantise it
into registers, serial devices into frames. It has no clock and does no I/O: who serves it decides
how fast sample numbers run.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.effects import get_effect
from calib.effects.base import Signals, State
from calib.effects.text import parse_term
from calib.errors import AddressError
from calib.gravity import STANDARD_GRAVITY
from calib.model import SensorModel, Triad
from calib.simulation.bench import bench_protocol
from calib.types import FloatArray
from drivers.address import Address
from drivers.driver import Driver

DEGREE = np.pi / 180.0
BLOCK = 4096


@dataclass(frozen=True)
class EmulatorOptions:
    """How an emulator runs.

    ``rate`` is in Hz (None: the device's own default), ``speed`` is emulated over real time
    (0: as fast as the reader takes it), ``effects`` are further terms of the sensor, as
    `calib.effects.text.parse_term` reads them.
    """

    rate: float | None = None
    seed: int = 0
    motion: str = "still"
    speed: float = 1.0
    effects: tuple[str, ...] = ()

    @classmethod
    def from_address(cls, address: Address, *more: str) -> EmulatorOptions:
        """Return the options that stand in an ``emulator://`` address; `more` are other known keys.

        Raises
        ------
        AddressError
            If the address holds another option, or one that does not parse.
        """
        address.check({"rate", "seed", "motion", "speed", "effect", *more})
        return cls(
            rate=address.number("rate", 0.0) or None,
            seed=address.integer("seed", 0),
            motion=address.choice("motion", MOTIONS, "still"),
            speed=address.number("speed", 1.0),
            effects=tuple(filter(None, address.options.get("effect", "").split(";"))),
        )


@dataclass(frozen=True)
class Emulator:
    """One emulated device. A file of this folder sets ``EMULATOR`` to one of these.

    Parameters
    ----------
    name : str
        As in ``emulator://NAME`` and ``imu-cal emulate NAME``.
    summary : str
        One line for the user.
    driver : callable
        Returns an unopened driver for ``emulator://NAME``, all in this process.
    serve : callable
        ``serve(options, announce, stop)`` opens a pty or a bus file that any program can use, calls
        ``announce(address)`` once it is ready, and runs until ``stop`` is set.
    """

    name: str
    summary: str
    driver: Callable[[Address], Driver]
    serve: Callable[[EmulatorOptions, Callable[[str], None], threading.Event], None]


class EmulatedSensor:
    """An imperfect sensor moved along a script; random access by sample number.

    After the script's end it rests in the last pose.

    Parameters
    ----------
    state : State
        The true state, sampled evenly at `rate`.
    rate : float, Hz
    model : SensorModel
        The errors that a calibration must find.
    accel_noise, gyro_noise : float
        One-sided noise densities, (m/s²)/√Hz and (rad/s)/√Hz.
    seed : int
        Sample k has the same noise however the samples are asked for.
    """

    def __init__(
        self,
        state: State,
        *,
        rate: float,
        model: SensorModel,
        accel_noise: float,
        gyro_noise: float,
        seed: int,
    ) -> None:
        self.state = state
        self.rate = rate
        self.model = model
        self._sigma = np.repeat([accel_noise, gyro_noise], 3) * np.sqrt(rate / 2.0)
        self._seed = seed
        self._blocks: dict[int, FloatArray] = {}

    @cached_property
    def _clean(self) -> FloatArray:
        return np.hstack(self.model.distort(self.state))

    @property
    def script_length(self) -> int:
        """How many samples the script has before the sensor rests."""
        return int(self.state.time.size)

    def measure(self, start: int, stop: int) -> tuple[Signals, FloatArray]:
        """Return the signals ((n, 3), (n, 3)) and temperature (n,) of samples ``[start, stop)``."""
        index = np.minimum(np.arange(start, stop), self.script_length - 1)
        both = self._clean[index] + self._noise(start, stop)
        temperature = self.state.temperature
        assert temperature is not None
        return Signals(both[:, :3], both[:, 3:]), temperature[index]

    def _noise(self, start: int, stop: int) -> FloatArray:
        first, last = start // BLOCK, (max(stop, start + 1) - 1) // BLOCK
        for block in list(self._blocks):
            if not first <= block <= last:
                del self._blocks[block]
        for block in range(first, last + 1):
            if block not in self._blocks:
                generator = np.random.default_rng([self._seed, block])
                self._blocks[block] = generator.normal(size=(BLOCK, 6)) * self._sigma
        whole = np.concatenate([self._blocks[b] for b in range(first, last + 1)])
        return whole[start - first * BLOCK : stop - first * BLOCK]


def make_sensor(options: EmulatorOptions, *, default_rate: float) -> EmulatedSensor:
    """Return the sensor that `options` ask for, with errors drawn from its seed.

    The errors have the size of a consumer part's: accelerometer bias 40 mg, gyroscope bias 2 dps,
    scale factor 1 %, misalignment 0.5°, noise 200 µg/√Hz and 0.007 dps/√Hz.

    Raises
    ------
    AddressError
        If an effect is none, or cannot be of such a motion.
    """
    rate = options.rate or default_rate
    generator = np.random.default_rng(options.seed)
    state = MOTIONS[options.motion](rate, options.seed)
    span = (float(state.time[0]), float(state.time[-1]))
    try:
        terms = tuple(parse_term(text, span=span) for text in options.effects)
        for term in terms:
            get_effect(term.effect).check_counts(term.parameters, samples=len(state.time))
    except ValueError as error:
        raise AddressError(f"`effect` of the address: {error}") from error
    return EmulatedSensor(
        state,
        rate=rate,
        model=replace(draw_model(generator), terms=terms),
        accel_noise=200e-6 * STANDARD_GRAVITY,
        gyro_noise=0.007 * DEGREE,
        seed=options.seed,
    )


def draw_model(generator: np.random.Generator) -> SensorModel:
    """Draw a consumer part's errors; accelerometer misalignment is lower triangular."""

    def triad(bias: float, mask: FloatArray) -> Triad:
        return Triad(
            bias=generator.normal(size=3) * bias,
            scale_factor_error=generator.normal(size=3) * 0.01,
            misalignment=generator.normal(size=(3, 3)) * 0.5 * DEGREE * mask,
        )

    ones = np.ones((3, 3))
    accel = triad(0.04 * STANDARD_GRAVITY, np.tril(ones, -1))
    return SensorModel(accel, triad(2.0 * DEGREE, ones - np.eye(3)))


def _still(rate: float, seed: int) -> State:
    """Rest level, z up, at 25 °C, for ever."""
    force = np.array([[0.0, 0.0, STANDARD_GRAVITY]])
    return State(time=np.zeros(1), force=force, rate=np.zeros((1, 3)), temperature=np.full(1, 25.0))


def _bench(rate: float, seed: int) -> State:
    """Thirty static poses with hand turns between them."""
    motion = bench_protocol(np.random.default_rng(seed))
    return motion.state(np.arange(int(motion.duration * rate)) / rate)


MOTIONS: dict[str, Callable[[float, int], State]] = {"still": _still, "bench": _bench}
"""Motion scripts by name: from rate (Hz) and seed to the true state at that rate."""
