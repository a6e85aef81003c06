"""Low-pass in the sensor: amplitude falls with frequency, and the signal comes late."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache

import numpy as np
from scipy import linalg

from calib.effects.base import (
    PRESENCE,
    SPLINE_REACH,
    Column,
    Parameter,
    ShapeParameter,
    Signals,
    State,
    TransformEffect,
    seconds_of_samples,
)
from calib.effects.resampling import (
    each_triad,
    present,
    resample,
    triad_column,
)
from calib.recording import CHANNELS
from calib.spline import spline_at, spline_slopes
from calib.types import ComplexArray, FloatArray, IntArray

GONE = 0.05
"""Share of a signal below which a low-pass has taken it away for good: a hand's tremor is ten to
fifty times the noise of a consumer part."""

LATE_STAMP = 2.5
"""Intervals that two steps beside each other have between them at most, if no sample is missing."""

AT_SAMPLES = 0
"""The order of a first-order low-pass that is worked out at the samples."""

CONTINUED = 0.5
"""How far values are continued beyond either end, s: several times the delay of any low-pass."""


class Bandwidth(TransformEffect):
    """First order ``1 / (1 + s/w0)``, second ``1 / (1 + sqrt(2) s/w0 + s²/w0²)`` (Butterworth).

    The filter is discretised for signals that are a cubic spline between samples, at the median
    sample interval T. One of order 0 is the first order as firmware works it out at the samples,
    ``y[k] = y[k-1] + (1 - exp(-w0 T)) (x[k] - y[k-1])``: it has each of them at once, where the
    other follows it from then on, and so is earlier by up to half of T.

    A part may filter both triads alike, and so does the mean over a sample interval. Their common
    delay is then no part of it (that is `time_offset`'s ``delay``, which needs a reference): what
    is left is amplitude.
    """

    slug = "bandwidth"
    title = "bandwidth"
    equation = (
        "x_m = x / (1 + s/w0), x / (1 + sqrt(2) s/w0 + s²/w0²), or at the samples "
        "x (1 - p) / (1 - p/z), p = exp(-w0 T); w0 = 2 pi cutoff"
    )
    source = (
        "Digital low-pass of the part: 5 to 260 Hz (MPU-6050 register map rev. 4.2, DLPF_CFG); "
        "mechanical response of the proof mass"
    )
    parameters = (
        Parameter("accel", PRESENCE, 1.0, ("accel.x", "accel.y", "accel.z")),
        Parameter("gyro", PRESENCE, 1.0, ("gyro.x", "gyro.y", "gyro.z")),
        Parameter("both", PRESENCE, 1.0, CHANNELS),
    )
    shape = (
        ShapeParameter("accel_cutoff", "Hz", 3.0, 300.0, optional=True),
        ShapeParameter("gyro_cutoff", "Hz", 3.0, 300.0, optional=True),
        ShapeParameter("both_cutoff", "Hz", 3.0, 300.0, optional=True),
        ShapeParameter("order", "", 0, 2, "integer", optional=True),
    )
    follows = "frequency of the signal"
    needs = "motion over a range of frequencies; its delay alone is the same as time_offset"
    sentence = "Fast changes come out smaller and later: the sensor's low-pass is too low for them."
    rivals = ("time_offset", "gyro_scale_nonlinearity")

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        both = present(parameters, "both", "both_cutoff")
        late = 0.0 if both is None else group_delay(both, 2, interval)
        return SPLINE_REACH + seconds_of_samples(late, interval)

    def typical(self, *, span: tuple[float, float]) -> dict[str, float]:
        """Return a filter for each triad: one that both have in common would be a second in a row.

        The rest is as for any effect.
        """
        whole = super().typical(span=span)
        return {name: value for name, value in whole.items() if name != "both_cutoff"}

    def is_form(self, shape: Mapping[str, float]) -> bool:
        """Return whether it is; of both triads orders 0 and 1 differ by a delay only."""
        return not ("both_cutoff" in shape and shape.get("order") == AT_SAMPLES)

    def in_words(self, shape: Mapping[str, float]) -> str:
        if shape.get("order") == AT_SAMPLES:
            return "It is worked out at the samples, as firmware does."
        return ""

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return what the low-pass takes away from each triad whose cut-off is given.

        Of signals that their samples resolve: no spline between them is as exact.
        """
        order = int(shape.get("order", 1))
        both = shape.get("both_cutoff")
        out: dict[str, Column] = {}
        for triad in ("accel", "gyro"):
            cutoff = shape.get(f"{triad}_cutoff")
            if cutoff is not None:
                out[triad] = triad_column(triad, _change(state, triad, cutoff, order))
        if both is not None:
            early = group_delay(both, order, state.interval)
            out["both"] = {
                **triad_column("accel", _change(state, "accel", both, order, early)),
                **triad_column("gyro", _change(state, "gyro", both, order, early)),
            }
        return out

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        order = int(parameters.get("order", 1))
        out = each_triad(
            signals, parameters, "cutoff", lambda x, cutoff: low_pass(time, x, cutoff, order=order)
        )
        both = present(parameters, "both", "both_cutoff")
        if both is None:
            return out
        return Signals(*(prompt_low_pass(time, x, both, order=order) for x in out))

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Add the derivatives that the low-pass took away; noise near the sample rate stays."""
        order = int(parameters.get("order", 1))
        both = present(parameters, "both", "both_cutoff")
        if both is not None:
            before = time - group_delay(both, order, _step(time))
            signals = Signals(
                *(resample(time, _sharpen(time, x, both, order=order), before) for x in signals)
            )
        return each_triad(
            signals, parameters, "cutoff", lambda x, cutoff: _sharpen(time, x, cutoff, order=order)
        )

    def restorer(
        self, signals: Signals, *, interval: float
    ) -> Callable[[Mapping[str, float]], Signals]:
        spectra = [_Spectrum(values, interval, interval) for values in signals]

        def restore(parameters: Mapping[str, float]) -> Signals:
            order = int(parameters.get("order", 1))
            both = present(parameters, "both", "both_cutoff")
            late = 0.0 if both is None else group_delay(both, order, interval)
            out = []
            for triad, values, spectrum in zip(("accel", "gyro"), signals, spectra, strict=True):
                passed = [(both, late), (present(parameters, triad, f"{triad}_cutoff"), 0.0)]
                known = [(cutoff, t) for cutoff, t in passed if cutoff is not None]
                out.append(spectrum.restored(known, order=order) if known else values)
            return Signals(*out)

        return restore


def prompt_low_pass(
    time: FloatArray,
    values: FloatArray,
    cutoff: float,
    *,
    order: int,
) -> FloatArray:
    """Return (n, k) values through the low-pass, its delay at low frequency taken off."""
    late = low_pass(time, values, cutoff, order=order)
    return resample(time, late, time + group_delay(cutoff, order, _step(time)))


def group_delay(cutoff: float, order: int, step: float) -> float:
    """Return by how much slow signals come late, s, through a low-pass of samples ``step`` s."""
    if order == AT_SAMPLES:
        return float(step / np.expm1(2 * np.pi * cutoff * step))
    return (1.0, float(np.sqrt(2)))[order - 1] / (2 * np.pi * cutoff)


def cutoff_of(delay: float, order: int, step: float) -> float:
    """Return the cut-off, Hz, of the low-pass that has such a group delay, s."""
    if order == AT_SAMPLES:
        return float(np.log1p(step / delay) / (2 * np.pi * step))
    return group_delay(delay, order, step)  # each is in proportion to one over the other


def low_pass(
    time: FloatArray,
    values: FloatArray,
    cutoff: float,
    *,
    order: int,
) -> FloatArray:
    """Return (n, k) values through the low-pass, which starts settled at the first of them."""
    if len(time) < 2:
        return values
    step = _step(time)
    slopes = spline_slopes(time, values) if len(time) > 3 else np.gradient(values, time, axis=0)
    # One signal after the other in memory, as the solver has them.
    level, slope = (np.ascontiguousarray(x.T, np.float64) for x in (values, step * slopes))
    levels, ends, den = _discrete(2 * np.pi * cutoff, step, order)
    # den[0] y[k] + den[1] y[k-1] + ... = levels[0] x[k] + levels[1] x[k-1] + ... + ends[0] s[k] +
    # ..., all x and y before the first being the first value: a lower triangular band.
    right = np.zeros_like(level)
    for k in range(len(den)):
        right[:, k:] += levels[k] * level[:, : len(values) - k]
        right[:, k:] += ends[k] * slope[:, : len(values) - k]
        right[:, : min(k, len(values))] += (levels[k] - den[k]) * level[:, :1]
    # The slope at the first is that of what follows, and not of what was before.
    right[:, 0] -= ends[0] * slope[:, 0]
    right[:, 1] -= ends[-1] * slope[:, 0]
    band = np.repeat(den[None], len(values), axis=0).T
    out, _ = linalg.lapack.dtbtrs(band, right.T, uplo="L", overwrite_b=1)
    return np.asarray(out)


def _discrete(w0: float, step: float, order: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what multiplies inputs and their slopes, and the denominator, in ``1/z``.

    Beyond those of its order, the last for slopes is of one at the end of the step before.

    Between samples the input is the cubic that has its values and slopes (per step) at both ends.
    For straight lines, what a low-pass with a cut-off beyond half the sample rate does to a wave
    of a tenth of that rate would be wrong by two thirds.

    References
    ----------
    .. [1] Franklin, Powell, Workman, "Digital Control of Dynamic Systems", 3rd ed., section 6.3.2
       (triangle-hold equivalent; here of a cubic): from the exponential of the augmented system
       matrix.
    """
    if order == AT_SAMPLES:
        pole = np.exp(-w0 * step)
        return np.array([1.0 - pole, 0.0]), np.zeros(3), np.array([1.0, -pole])
    system = np.zeros((order + 4, order + 4))
    if order == 1:
        system[0, :2] = -w0 * step, w0 * step
    else:
        system[0, :3] = -np.sqrt(2) * w0 * step, -(w0**2) * step, w0**2 * step
        system[1, 0] = step
    system[order:, order:] = np.eye(4, k=1)
    held = linalg.expm(system)
    state = held[:order, :order]
    # By the coefficients of a cubic (derivatives over factorials), and by its ends.
    drive = held[:order, order:] * [1.0, 1.0, 2.0, 6.0] @ _CUBIC
    den = np.poly(state)
    # By Cayley and Hamilton's theorem; the output is the last state.
    before = (state + den[1] * np.eye(order))[-1] @ drive
    taps = np.zeros((3, 2))
    taps[:2] += drive[-1].reshape(2, 2)
    taps[1:] += before.reshape(2, 2)
    levels, ends = taps[: order + 1].T
    return levels, np.append(ends, before[1]), np.asarray(den)


_CUBIC = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [3.0, -1.0, -3.0, -2.0], [-2.0, 1.0, 2.0, 1.0]]
)
"""A cubic's coefficients from value and slope at its end, and value and slope at its start."""


def _sharpen(time: FloatArray, values: FloatArray, cutoff: float, *, order: int) -> FloatArray:
    if len(time) < 4:
        return values
    w0 = 2 * np.pi * cutoff
    if order == AT_SAMPLES:
        pole = np.exp(-w0 * _step(time))
        return np.asarray(
            values + pole / (1.0 - pole) * np.diff(values, axis=0, prepend=values[:1])
        )
    slope = spline_slopes(time, values)
    if order == 1:
        return values + slope / w0
    # The second derivative of a piece at its start, and of the last at its end.
    step = np.diff(time)[:, None]
    bend = 6 * np.diff(values, axis=0) / step - 4 * slope[:-1] - 2 * slope[1:]
    end = -6 * (values[-1] - values[-2]) / step[-1] + 2 * slope[-2] + 4 * slope[-1]
    curve = np.vstack((bend / step, end / step[-1]))
    return np.asarray(values + np.sqrt(2) / w0 * slope + curve / w0**2)


def _step(time: FloatArray) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else 1.0


class _Spectrum:
    """The spectrum of (n, k) values, taken once for any low-pass.

    Values are ``interval`` s apart, and the samples at which a low-pass is worked out `step`.
    """

    def __init__(self, values: FloatArray, interval: float, step: float) -> None:
        # On at either end as it came there, turned about it: who begins or ends in a motion does
        # not stop. Then held, to a length of small factors, and backwards, so that it comes round.
        more = min(int(np.ceil(CONTINUED / interval)), len(values) - 1)
        before = 2.0 * values[:1] - values[more:0:-1]
        after = 2.0 * values[-1:] - values[-2 : -2 - more : -1]
        longer = np.concatenate((before, values, after))
        n = _smooth_number(len(longer))
        held = np.repeat(longer[-1:], n - len(longer), axis=0)
        whole = np.concatenate((longer.T, held.T), axis=1)
        there_and_back = np.concatenate((whole, whole[:, ::-1]), axis=1)
        self._step = step
        self._within, self._length = slice(more, more + len(values)), 2 * n
        self._frequency = np.asarray(np.fft.rfftfreq(2 * n, interval))
        self._values = np.fft.rfft(there_and_back)

    def passed(self, cutoff: float, *, order: int, early: float = 0.0) -> FloatArray:
        """Return the (n, k) values through a low-pass, its output moved to be `early` (s)."""
        gain = self._response(cutoff, order)
        if early:
            gain = gain * np.exp(2j * np.pi * self._frequency * early)
        return np.fft.irfft(gain * self._values, self._length)[:, self._within].T

    def _response(self, cutoff: float, order: int) -> ComplexArray:
        return _response(self._frequency, cutoff, order, self._step)

    def restored(self, low_passes: Iterable[tuple[float, float]], *, order: int) -> FloatArray:
        """Return the (n, k) values as they were before low-passes.

        Each has a cut-off, and its output was moved by some seconds. What it left less than `GONE`
        of is noise by now, and stays away (Wiener's filter).
        """
        spectrum = self._values
        for cutoff, late in low_passes:
            passed = self._response(cutoff, order)
            if late:
                passed *= np.exp(2j * np.pi * self._frequency * late)
            power = np.square(passed.real) + np.square(passed.imag)
            spectrum = (1 + GONE**2) * passed.conj() / (power + GONE**2) * spectrum
        return np.fft.irfft(spectrum, self._length)[:, self._within].T


@lru_cache(maxsize=2)
def _spectrum(state: State, triad: str) -> tuple[_Spectrum, IntArray]:
    """Return the spectrum of a triad's true signals, for many cut-offs one after another.

    And the place of each time among even ones, in which gaps are bridged by a spline.
    """
    values = state.force if triad == "accel" else state.rate
    step, place = _step(state.time), _places(state.time)
    if place[-1] >= len(place) > 3:
        even = np.arange(place[-1] + 1, dtype=np.float64)
        values = spline_at(place.astype(np.float64), values, even)
    return _Spectrum(values, step, state.interval), place


def _places(time: FloatArray) -> IntArray:
    """Return the place of each of (n,) times among even ones.

    A long step beside a short one is a stamp that came late. Beyond `CONTINUED` no low-pass
    remembers what was before a gap.
    """
    interval = _step(time)
    step = np.pad(np.diff(time) / interval, 1, constant_values=1.0)
    gap = step[1:-1] + np.minimum(step[:-2], step[2:]) > LATE_STAMP
    apart = np.where(gap, np.clip(np.round(step[1:-1]), 1, max(1, round(CONTINUED / interval))), 1)
    return np.append(0, np.cumsum(apart.astype(np.int64)))


def _change(state: State, triad: str, cutoff: float, order: int, early: float = 0.0) -> FloatArray:
    """Return what a low-pass, its output `early` seconds before, adds to a triad, (n, 3)."""
    spectrum, place = _spectrum(state, triad)
    passed = spectrum.passed(cutoff, order=order, early=early)[place]
    return passed - (state.force if triad == "accel" else state.rate)


def _response(frequency: FloatArray, cutoff: float, order: int, step: float) -> ComplexArray:
    """Return what the low-pass makes of sinusoids."""
    if order == AT_SAMPLES:
        pole = np.exp(-2 * np.pi * cutoff * step)
        return np.asarray((1 - pole) / (1 - pole * np.exp(-2j * np.pi * frequency * step)))
    s = 1j * frequency / cutoff
    return np.asarray(1 / (1 + s) if order == 1 else 1 / (1 + np.sqrt(2) * s + s**2))


def _smooth_number(least: int) -> int:
    """Return the least product of twos, threes and fives that is no less."""
    sizes = np.ones(1, np.int64)
    for p in (2, 3, 5):
        powers = p ** np.arange(np.ceil(np.log(least) / np.log(p)) + 1, dtype=np.int64)
        sizes = np.outer(sizes, powers).ravel()
        sizes = sizes[sizes < 2 * least]
    return int(sizes[sizes >= least].min())


EFFECT = Bandwidth()
