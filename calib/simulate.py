"""Motion + sensor model + noise -> recording.

``measured = readout(transforms(distort(true)) + noise)``, sampled on the sensor's own clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.effects import get_effect
from calib.effects.base import Signals, State
from calib.model import SensorModel
from calib.recording import Clock, DeviceInfo, Recording
from calib.simulation.kinematics import Motion
from calib.simulation.noise import NoiseModel
from calib.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Sampling:
    """How the sensor samples, and what its clock says.

    Parameters
    ----------
    clock_offset : float, s
        What the clock shows at the true time 0.
    clock_scale : float
        Relative error of its rate: stamps are ``offset + (1 + scale) t``.
    jitter : float, s
        Standard deviation of a stamp about that line, cut at 0.4 of the sample interval. Samples
        themselves are taken evenly.
    lost : float
        Probability that a run of samples goes missing at any one sample (counted in ``lost``).
    lost_run : float
        Mean length of such a run.
    clock : {"device", "host", "nominal", "invalid"}
        What the recording says of its clock.
    """

    clock_offset: float = 0.0
    clock_scale: float = 0.0
    jitter: float = 0.0
    lost: float = 0.0
    lost_run: float = 1.0
    clock: Clock = "device"

    def __post_init__(self) -> None:
        if not self.clock_scale > -1:
            raise ValueError(f"`clock_scale` must be above -1, got {self.clock_scale}")
        if not 0 <= self.lost < 1:
            raise ValueError(f"`lost` must be in [0, 1), got {self.lost}")
        if not 1 <= self.lost_run < np.inf:
            raise ValueError(f"`lost_run` must be at least 1, got {self.lost_run}")
        if not 0 <= self.jitter < np.inf:
            raise ValueError(f"`jitter` must be 0 s or more, got {self.jitter}")

    def stamps(self, time: FloatArray, *, rng: np.random.Generator) -> FloatArray:
        """Return what the clock shows at (n,) true times."""
        shown: FloatArray = self.clock_offset + (1 + self.clock_scale) * time
        if self.jitter and len(time) > 1:
            bound = 0.4 * float(np.diff(time).min())
            shown = shown + np.clip(rng.normal(0.0, self.jitter, len(time)), -bound, bound)
        return shown


IDEAL = Sampling()

FINE, MANY = 400.0, 4_000_000
"""Hz at which motion is sampled where a sensor is late or has a low-pass, for so many samples at
most: a cubic through samples at 50 Hz would move a tremor of 10 Hz by 0.6 % of what it is."""


def simulate(
    motion: Motion,
    model: SensorModel,
    noise: NoiseModel,
    *,
    rng: np.random.Generator,
    rate: float | None = None,
    time: FloatArray | None = None,
    device: DeviceInfo | None = None,
    sampling: Sampling = IDEAL,
) -> Recording:
    """Return what a sensor records on a motion.

    Parameters
    ----------
    motion : Motion
    model : SensorModel
        Its moments are read off the sensor's own clock, as whoever sees the recording reads them;
        time constants and cut-offs are true ones.
    noise : NoiseModel
    rng : numpy Generator
    rate : float, Hz
        Samples are taken every 1/rate from 0 to the motion's end. Or give
    time : (n,) array, s
        the true times of the samples, within the motion.
    device : DeviceInfo
        Its full scale clips the output and its LSB rounds it, where they are known.
    sampling : Sampling
        Clock and lost samples.

    Returns
    -------
    Recording
        Shorter than asked by the samples that `model` loses, whose clock does not notice, or that a
        slow clock puts after the motion's end, and without those where the motion is hidden.

    Raises
    ------
    ValueError
        If not exactly one of `rate` and `time` is given, or it does not fit the motion.
    """
    device = DeviceInfo(chip="simulated") if device is None else device
    true_time = _sample_times(motion, rate, time)
    model = _by_true_time(model, sampling)
    start = sampling.clock_offset
    state = motion.state(true_time)
    state = replace(state, time=true_time + start, power_on=motion.power_on + start)
    random = noise.draw(true_time, rng=rng)
    if state.vibration is not None:
        shake = np.sqrt(state.vibration) * rng.normal(size=state.force.shape)
        random = Signals(random.accel + shake @ model.accel.matrix.T, random.gyro)
    measured = _distorted(model, motion, true_time, state, random)
    accel = _read_out(measured.accel, device.accel_full_scale, device.accel_lsb)
    gyro = _read_out(measured.gyro, device.gyro_full_scale, device.gyro_lsb)
    temperature = state.temperature
    if temperature is not None and noise.temperature:
        temperature = temperature + rng.normal(0.0, noise.temperature, len(true_time))
    stamps = sampling.stamps(true_time, rng=rng)
    there = motion.seen(true_time) & ~_lost(len(true_time), sampling, rng=rng)
    there[max(0, len(there) - model.ahead(state.time)) :] = False
    kept = np.flatnonzero(there)
    if device.rate is None:
        interval = np.median(np.diff(true_time)) if len(true_time) > 1 else np.inf
        device = replace(device, rate=float(rate if rate is not None else 1 / interval))
    return Recording(
        stamps[kept],
        accel[kept],
        gyro[kept],
        sampling.clock,
        temperature=None if temperature is None else temperature[kept],
        lost=np.diff(kept, prepend=-1) - 1,
        device=device,
        notes={"motion": motion.name},
    )


def digital_twin(
    recording: Recording,
    motion: Motion,
    model: SensorModel,
    noise: NoiseModel,
    *,
    rng: np.random.Generator,
) -> Recording:
    """Return what `model` would have recorded on the motion of a recording.

    It has the recording's times, lost samples, clock and device, where the motion is not hidden.

    Parameters
    ----------
    recording : Recording
    motion : Motion
        Its own, from `calib.simulation.recorded`: time 0 is the recording's first sample.
    model : SensorModel
    noise : NoiseModel
    rng : numpy Generator
    """
    start = float(recording.time[0])
    twin = simulate(
        motion,
        model,
        noise,
        rng=rng,
        time=recording.time - start,
        device=recording.device,
        sampling=Sampling(clock_offset=start, clock=recording.clock),
    )
    assert recording.lost is not None
    assert twin.lost is not None
    kept = np.flatnonzero(motion.seen(recording.time - start))[: len(twin)]
    # Samples that are hidden count as lost.
    known = np.diff(np.cumsum(recording.lost)[kept], prepend=0)
    notes = {"motion": "of a recording"}
    return replace(twin, time=recording.time[kept], lost=known + twin.lost, notes=notes)


def _by_true_time(model: SensorModel, sampling: Sampling) -> SensorModel:
    """Return the model with its moments in true seconds, from what the clock shows at time 0."""

    def true(moment: float) -> float:
        return sampling.clock_offset + (moment - sampling.clock_offset) / (1 + sampling.clock_scale)

    terms = []
    for term in model.terms:
        moments = {item.name for item in get_effect(term.effect).shape if item.is_moment}
        values = {k: true(v) if k in moments else v for k, v in term.parameters.items()}
        terms.append(replace(term, parameters=values))
    return replace(model, terms=tuple(terms))


def _distorted(
    model: SensorModel, motion: Motion, time: FloatArray, state: State, random: Signals
) -> Signals:
    """Return what the sensor measures at true times, where its clock and the motion say `state`."""
    interval = float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    every = int(np.ceil(FINE * interval - 1e-9)) if np.isfinite(interval) else 1
    if model.is_prompt or every == 1 or every * len(time) > MANY:
        return model.distort(state, random)
    whole = np.arange(len(time), dtype=float)
    between = np.arange((len(time) - 1) * every + 1) / every
    fine = motion.state(np.interp(between, whole, time))
    start = state.power_on - motion.power_on
    fine = replace(fine, time=fine.time + start, power_on=state.power_on)
    return model.distort(fine, random, every=every)


def _sample_times(motion: Motion, rate: float | None, time: FloatArray | None) -> FloatArray:
    if (rate is None) == (time is None):
        raise ValueError("give either `rate` or `time`, and not both")
    if time is not None:
        time = np.asarray(time, np.float64)
        if time.ndim != 1 or not len(time) or (len(time) > 1 and np.diff(time).min() <= 0):
            raise ValueError("`time` must be (n,), not empty, and increase")
        return time
    if rate is None or not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"`rate` must be positive and finite, got {rate}")
    return np.arange(int(np.floor(motion.duration * rate + 1e-9)) + 1) / rate


def _read_out(values: FloatArray, full_scale: float | None, lsb: float | None) -> FloatArray:
    """Round to whole counts and clip; two's complement reaches one count less on the upper side."""
    if full_scale is not None:
        values = np.clip(values, -full_scale, full_scale - (lsb or 0.0))
    return values if lsb is None else np.round(values / lsb) * lsb


def _lost(n: int, sampling: Sampling, *, rng: np.random.Generator) -> BoolArray:
    """Return which of n samples do not arrive."""
    gone = np.zeros(n, np.bool_)
    if sampling.lost:
        starts = np.flatnonzero(rng.random(n) < sampling.lost)
        for start, length in zip(
            starts, rng.geometric(1 / sampling.lost_run, len(starts)), strict=True
        ):
            gone[start : start + length] = True
        gone[[0, -1]] = False
    return gone
