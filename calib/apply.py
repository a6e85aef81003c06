"""Correct a stream with a calibration, batch by batch, as if it were corrected whole.

Baseline is the same for every sample by itself. Some further terms look at a sample's neighbours (a
rate of temperature, a delay, a low-pass): then the last samples of a batch wait for the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calib.calibration import Calibration
from calib.effects import get_effect
from calib.effects.base import State
from calib.model import affine
from calib.recording import Recording
from calib.thermometer import Temperature, known_temperature
from calib.types import BoolArray, FloatArray


@dataclass
class Coverage:
    """Which part of what was corrected lay outside the calibrated temperature range, or had none.

    ``start`` is the time of the first sample, s.
    """

    start: float | None = None
    samples: int = 0
    outside: int = 0
    without_temperature: int = 0
    low: float = np.inf
    high: float = -np.inf


@dataclass(frozen=True, eq=False)
class Block:
    """Samples as arrays: (n,) s, (n, 3) m/s², (n, 3) rad/s, (n,) °C or None. May hold NaN."""

    time: FloatArray
    accel: FloatArray
    gyro: FloatArray
    temperature: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time)


@dataclass
class Corrector:
    """Corrects blocks of one stream in their order.

    Parameters
    ----------
    calibration : Calibration
    interval : float, s
        Time between samples, by which time constants become numbers of samples.
    temperature : Temperature or None
        Where it is known better than what the thermometer reads by itself
        (`calib.thermometer.known_temperature`). A stream does not know what will be read next.

    Warm-up is counted from the stream's first sample.
    """

    calibration: Calibration
    interval: float
    coverage: Coverage = field(default_factory=Coverage)
    temperature: Temperature | None = None
    _held: Block | None = None
    _context: int = 0
    _start: float | None = None

    def __post_init__(self) -> None:
        terms = self.calibration.model.terms
        known = [(get_effect(term.effect), term.parameters) for term in terms]
        self.margin = sum(effect.reach(p, interval=self.interval) for effect, p in known)
        """How many samples the output lags behind the input; 0 for baseline."""
        self._memory = sum(effect.memory(p, interval=self.interval) for effect, p in known)
        model, housing = self.calibration.model, self.calibration.housing
        rotation = np.eye(3) if housing is None else housing.mat_hs
        self._affine = []
        for triad in (model.accel, model.gyro):
            matrix = rotation @ np.linalg.inv(triad.matrix)
            self._affine.append((matrix, -matrix @ triad.bias))

    def add(self, block: Block) -> tuple[FloatArray, FloatArray]:
        """Return the corrected accel and gyro (m, 3) of the next m samples of the stream.

        m is the number that came in, or, with terms that look at neighbours, as many as have all of
        theirs.
        """
        self._cover(block)
        if not self.calibration.model.terms:
            return self._baseline(block)
        if not self.margin:
            return self._correct(block)
        return self._advance(block, last=False)

    def finish(self) -> tuple[FloatArray, FloatArray]:
        """Return the corrected samples that were still waiting for their neighbours."""
        if self._held is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        return self._advance(None, last=True)

    def _baseline(self, block: Block) -> tuple[FloatArray, FloatArray]:
        accel, gyro = self._affine
        return affine(accel[0], block.accel, accel[1]), affine(gyro[0], block.gyro, gyro[1])

    def _correct(self, block: Block) -> tuple[FloatArray, FloatArray]:
        if not len(block):
            return block.accel, block.gyro
        if self._start is None:
            self._start = float(block.time[0])
        whole, bad = _fill(block)
        known, slope = self.temperature, None
        if known is not None:
            whole = replace(whole, temperature=known(whole.time))
            slope = known.rate_at(whole.time)
        signals = self.calibration.correct(
            State(
                whole.time,
                whole.accel,
                whole.gyro,
                whole.temperature,
                temperature_slope=slope,
                power_on=self._start,
                gravity=self.calibration.gravity.value,
            )
        )
        if bad.any():
            for values in signals:
                values[bad] = np.nan
        return signals.accel, signals.gyro

    def _advance(self, block: Block | None, *, last: bool) -> tuple[FloatArray, FloatArray]:
        parts = [part for part in (self._held, block) if part is not None]
        whole = _concatenate(parts)
        stop = len(whole) if last else max(self._context, len(whole) - self.margin)
        if stop == self._context:
            self._held = whole
            return np.zeros((0, 3)), np.zeros((0, 3))
        accel, gyro = self._correct(whole)
        out = accel[self._context : stop], gyro[self._context : stop]
        keep = max(0, stop - self._memory)
        self._held = None if last else _rows(whole, keep)
        self._context = stop - keep
        return out

    def _cover(self, block: Block) -> None:
        cover, span = self.coverage, self.calibration.temperature
        cover.samples += len(block)
        if len(block) and cover.start is None:
            cover.start = float(block.time[0])
        values = block.temperature
        values = None if values is None else values[np.isfinite(values)]
        if values is None or not len(values):
            cover.without_temperature += len(block)
        elif span is not None:
            low, high = float(values.min()), float(values.max())
            cover.low, cover.high = min(cover.low, low), max(cover.high, high)
            if low < span.low or high > span.high:
                cover.outside += int(np.count_nonzero((values < span.low) | (values > span.high)))


OF_SETUP = (
    "it belongs to the set-up that was recorded, such as where the sensor sat beside its "
    "reference, not to the sensor"
)


@dataclass(frozen=True)
class NotApplied:
    """A part of a calibration that a recording was not corrected for, and why."""

    effect: str
    reason: str


def not_applied(calibration: Calibration, coverage: Coverage) -> tuple[NotApplied, ...]:
    """Return what of a calibration was not applied: events, and terms whose input was missing.

    What belongs to the set-up is kept beside the events.
    """
    out = []
    for event in calibration.events:
        if get_effect(event.effect).kind == "setup":
            out.append(NotApplied(event.effect, OF_SETUP))
            continue
        spans = ", ".join(f"{a:.2f} to {b:.2f} s" for a, b in event.intervals)
        reason = f"at {spans} it is an event of the recording that was calibrated"
        out.append(NotApplied(event.effect, reason))
    for term in calibration.model.terms:
        reads = get_effect(term.effect).reads
        count, of = coverage.without_temperature, coverage.samples
        if "mat_ns" in reads:
            out.append(NotApplied(term.effect, "it needs the orientation, which nobody knows here"))
        elif "temperature" in reads and count:
            where = "the recording has" if count == of else f"{count} of {of} samples have"
            out.append(NotApplied(term.effect, f"{where} no temperature"))
    return tuple(out)


def from_power_on(calibration: Calibration) -> tuple[str, ...]:
    """Return the terms that count the time since the sensor was switched on."""
    terms = calibration.model.terms
    return tuple(term.effect for term in terms if get_effect(term.effect).from_power_on)


def reads_temperature(calibration: Calibration) -> bool:
    """Return whether what a calibration corrects goes with temperature."""
    terms = calibration.model.terms
    return any("temperature" in get_effect(term.effect).reads for term in terms)


def correct_recording(calibration: Calibration, recording: Recording) -> Recording:
    """Return a whole recording in corrected units, in the housing's frame if that is known."""
    known = known_temperature((recording,)) if reads_temperature(calibration) else None
    corrector = Corrector(calibration, recording.interval, temperature=known)
    block = Block(recording.time, recording.accel, recording.gyro, recording.temperature)
    parts = [corrector.add(block), corrector.finish()]
    accel = np.concatenate([part[0] for part in parts])
    gyro = np.concatenate([part[1] for part in parts])
    return replace(recording, accel=accel, gyro=gyro)


def _fill(block: Block) -> tuple[Block, BoolArray]:
    """Return the block with straight lines across what is not finite, and which rows those are.

    Terms that look at neighbours would otherwise spread one bad sample over all of them.
    """
    temperature = block.temperature
    if temperature is not None and not np.isfinite(temperature).all():
        good = np.isfinite(temperature)
        temperature = (
            np.interp(block.time, block.time[good], temperature[good]) if good.any() else None
        )
    both = np.hstack([block.accel, block.gyro])
    bad: BoolArray = np.logical_not(np.isfinite(both).all(axis=1))
    if not bad.any():
        return replace(block, temperature=temperature), bad
    if bad.all():
        zero = np.zeros_like(block.accel)
        return Block(block.time, zero, zero, temperature), bad
    at = block.time[~bad]
    accel, gyro = (
        np.stack([np.interp(block.time, at, column[~bad]) for column in values.T], axis=1)
        for values in (block.accel, block.gyro)
    )
    return Block(block.time, accel, gyro, temperature), bad


def _concatenate(parts: list[Block]) -> Block:
    if len(parts) == 1:
        return parts[0]
    temperatures = [part.temperature for part in parts if part.temperature is not None]
    return Block(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.accel for part in parts]),
        np.concatenate([part.gyro for part in parts]),
        np.concatenate(temperatures) if len(temperatures) == len(parts) else None,
    )


def _rows(block: Block, start: int) -> Block:
    temperature = None if block.temperature is None else block.temperature[start:]
    return Block(block.time[start:], block.accel[start:], block.gyro[start:], temperature)
