"""What an effect is: its equation, its parameters, and how it changes the signals.

Two kinds change signals in two ways:

- An `Effect` adds ``sum_k p_k * column_k(state)`` to the measured signals. The columns are
  functions of the *true* state, linear in the parameters once the shape parameters (a time
  constant, a moment) are fixed.
- A `TransformEffect` acts on the finished signals (a delay, a low-pass, rounding). It also gives
  columns, which is how it is detected: its derivative with respect to each parameter at zero, or,
  for a parameter in the unit `PRESENCE`, the whole change that it makes.

A `Column` is sparse: it names only the channels that the parameter touches, each with (n,) values.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from calib.gravity import STANDARD_GRAVITY
from calib.recording import AXES
from calib.rotation import skew
from calib.spline import spline_slopes
from calib.types import BoolArray, FloatArray, IntArray

EffectKind = Literal["sensor", "event", "setup"]
"""A ``sensor`` term belongs in the calibration; an ``event`` happened once in this recording; a
``setup`` term belongs to the fixture or the reference."""


Column = Mapping[str, FloatArray]
"""What one unit of a parameter adds, by channel (``accel.x`` ... ``gyro.z``): (n,) arrays in m/s²
and rad/s. A channel that is not there is untouched."""

G = STANDARD_GRAVITY
"""Standard gravity, m/s²: what data sheets mean by g."""

FORM = "form"
"""Unit of a number that stands for one of several forms, which `Effect.in_words` says."""

SAMPLES = "samples"
"""Unit of a number of samples, which is whole."""

PRESENCE = "presence"
"""Unit of a parameter that only says whether the effect is there: 1, or 0. Its sizes are shape
parameters (a cut-off, a full scale); its column is the whole change made with that shape."""


WORST = 100.0
"""Times its typical size that a term of a sensor may have. What would have to be larger is no term
of it, whatever it explains: the gyroscopes of a worn-out part may feel 10 dps/g, and none 25."""

SPLINE_REACH = 32
"""Samples after which a cubic spline has forgotten its neighbours: it does by 0.27 a sample, and
the fixed point of `SensorModel.correct` repeats it."""

SLOPE_WINDOW, SLOPE_MEMORY = 20.0, 160.0
"""s through which the rate of temperature is fitted; and at most so many before a moment."""

SOONEST = 0.1
"""Quantile of the steps between times that is the interval of samples."""

STEPS = 4
"""Changes of a thermometer's reading through which its rate is fitted, where that many are."""


class Signals(NamedTuple):
    """A pair of (n, 3) arrays: accelerometer in m/s², gyroscope in rad/s."""

    accel: FloatArray
    gyro: FloatArray


@dataclass(frozen=True)
class Parameter:
    """A parameter that enters linearly.

    ``typical`` is the size that a consumer part has, in ``unit``; it sets the prior.
    ``reference_only`` marks a parameter that a recording shows only against a reference (motion
    capture, a commanded profile, a second sensor), never by itself. ``refining`` marks a higher
    order that no sensor has without the others. Nothing that is physical is smaller than ``least``
    or larger than ``most``; where these are None, `Effect.limits` says how large it may be.
    """

    name: str
    unit: str
    typical: float
    channels: tuple[str, ...]
    reference_only: bool = False
    refining: bool = False
    least: float | None = None
    most: float | None = None


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that enters nonlinearly, searched between ``low`` and ``high``.

    ``spacing`` is how candidates are spread: ``log`` for time constants, ``linear`` for moments,
    ``integer`` for codes, whose unit is empty. Bounds of None mean the recording's own span (of
    time, or of the signal for a full scale). An ``optional`` one may be left out of a `Term`: that
    part is not there then.
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    spacing: Literal["log", "linear", "integer"] = "log"
    optional: bool = False

    @property
    def is_moment(self) -> bool:
        """Whether it is a time of the recording."""
        return self.low is None and self.unit == "s"

    @property
    def codes(self) -> range:
        """The values of an integer."""
        return range(int(self.low or 0), int(self.high or 0) + 1)


@dataclass(frozen=True, eq=False)
class State:
    """The true state that effects are functions of, on (n,) times; everything in SI and frame s.

    Parameters
    ----------
    time : (n,) array, s
    force, rate : (n, 3) arrays
        Specific force (m/s²) and angular rate (rad/s).
    temperature : (n,) array, °C, or None
        None where it was not measured: effects of temperature then have no columns.
    reference_temperature : float, °C
        What temperature terms are relative to.
    power_on : float, s
        The moment that warm-up is counted from.
    since_turn : (n,) array, s, or None
        Time since the last turn ended, on through the next turn; infinite before the first.
    turning : (n,) array of bool, or None
        Whether a turn is under way.
    mat_ns : (n, 3, 3) array or None
        Orientation, where it is known.
    vibration : (n, 3) array, (m/s²)², or None
        Short-time variance of the specific force.
    angular_acceleration : (n, 3) array, rad/s², or None
        Where it is known exactly, as in simulation; otherwise `rate_dot` differences the rate.
    temperature_slope : (n,) array, K/s, or None
        The same of temperature; otherwise `temperature_rate` fits it.
    gravity : float, m/s²
    known_gradient : (n, 3, 3) array, 1/s², or None
        `gradient`, where it is known better than from the rate: that of signals that have passed a
        low-pass is not what a low-pass leaves of it, as it has products of the rate.
    length : (n,) array, s, or None
        Time about each over which it is a mean; 0, and None, for what is a sample.
    captured : State or None
        The same as a reference showed it, where that was smoothed and this is what it lost.
    sampling : float, s, or None
        Interval of what the sensor puts out, where the times are fewer.
    """

    time: FloatArray
    force: FloatArray
    rate: FloatArray
    temperature: FloatArray | None = None
    reference_temperature: float = 25.0
    power_on: float = 0.0
    since_turn: FloatArray | None = None
    turning: BoolArray | None = None
    mat_ns: FloatArray | None = None
    vibration: FloatArray | None = None
    angular_acceleration: FloatArray | None = None
    temperature_slope: FloatArray | None = None
    gravity: float = G
    known_gradient: FloatArray | None = None
    length: FloatArray | None = None
    captured: State | None = None
    sampling: float | None = None

    def since(self, moment: float | FloatArray) -> FloatArray:
        """Return the share of each time, (n,), that is after a moment: 0 or 1 for samples."""
        after = self.time >= moment
        if self.length is None:
            return after.astype(float)
        share = (self.time - moment) / np.where(self.length > 0, self.length, 1.0) + 0.5
        return np.where(self.length > 0, np.clip(share, 0.0, 1.0), after)

    @cached_property
    def interval(self) -> float:
        """Interval of what the sensor puts out, s. Of rests there may be fewer points."""
        if self.sampling is not None or len(self.time) < 2:
            return self.sampling or 1.0
        return float(np.quantile(np.diff(self.time), SOONEST))

    def derivative(self, values: FloatArray) -> FloatArray:
        """Return the time derivative of (n, ...) values, of their cubic spline through all times.

        Second-order differences would lose 6 % of a 10 Hz tremor at 100 Hz, a spline 0.1 %.
        """
        if len(self.time) < 4:
            return np.gradient(values, self.time, axis=0) if len(self.time) > 2 else 0.0 * values
        return spline_slopes(self.time, values)

    @cached_property
    def force_dot(self) -> FloatArray:
        """Time derivative of the specific force, m/s³."""
        return self.derivative(self.force)

    @cached_property
    def rate_dot(self) -> FloatArray:
        """Angular acceleration, rad/s²."""
        if self.angular_acceleration is not None:
            return self.angular_acceleration
        return self.derivative(self.rate)

    @cached_property
    def gradient(self) -> FloatArray:
        """What a metre of distance adds to the acceleration: ``skew(w)² + skew(dw/dt)``, 1/s²."""
        if self.known_gradient is not None:
            return self.known_gradient
        turn = skew(self.rate)
        return np.asarray(turn @ turn + skew(self.rate_dot))

    @cached_property
    def gravity_direction(self) -> FloatArray:
        """Unit vector up, in frame s, (n, 3): from the orientation, else along the force."""
        if self.mat_ns is not None:
            return self.mat_ns[:, 2, :]
        size: FloatArray = np.linalg.norm(self.force, axis=1, keepdims=True)
        return self.force / size

    @cached_property
    def warmth(self) -> FloatArray | None:
        """Temperature minus the reference, K."""
        if self.temperature is None:
            return None
        return self.temperature - self.reference_temperature

    @cached_property
    def temperature_rate(self) -> FloatArray | None:
        """Rate of temperature, K/s, (n,): the slope of a line through `SLOPE_WINDOW` s.

        A sensor's thermometer is far too noisy to be differenced from sample to sample. Of one with
        steps so coarse that it shows fewer than `STEPS` of them in that time, the line goes back
        further, through up to `SLOPE_MEMORY` s: else each step would be a pulse of the rate.
        """
        if self.temperature is None or self.temperature_slope is not None:
            return self.temperature_slope
        first, last = windows(self.time, SLOPE_WINDOW)
        changes = np.cumsum(np.diff(self.temperature, prepend=self.temperature[:1]) != 0)
        for back in np.geomspace(SLOPE_WINDOW, SLOPE_MEMORY, 4):
            few = changes[last - 1] - changes[first] < STEPS
            first = np.where(few, np.searchsorted(self.time, self.time - back), first)
        return line_slope(self.time, self.temperature, first, last)


def line_slope(time: FloatArray, values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the least-squares slopes of (n,) values over samples ``[first, last)``."""
    if len(time) < 2:
        return np.zeros_like(values)
    t, x = time - time.mean(), values - values.mean()
    sums = np.zeros((4, len(t) + 1))
    np.cumsum([t, x, t * t, t * x], axis=1, out=sums[:, 1:])
    count = last - first
    st, sx, stt, stx = sums[:, last] - sums[:, first]
    slope: FloatArray = (stx - st * sx / count) / (stt - st * st / count)
    return slope


def windows(
    time: FloatArray, width: float, *, within: tuple[IntArray, IntArray] | None = None
) -> tuple[IntArray, IntArray]:
    """Return the samples ``[first, last)`` that are within half a width, s, of each of n times.

    At least three, that low rates have some. None reaches out of ``within``, which is a range for
    each sample.
    """
    half = 0.5001 * width  # samples at both edges count, however their times are rounded
    low, high = (0, len(time)) if within is None else within
    index = np.arange(len(time))
    first = np.minimum(np.searchsorted(time, time - half), index - 1)
    last = np.maximum(np.searchsorted(time, time + half, side="right"), index + 2)
    return np.maximum(first, low), np.minimum(last, high)


def window_mean(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the means (n, k) of (n, k) values over samples ``[first, last)``."""
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    mean: FloatArray = (total[last] - total[first]) / (last - first)[:, None]
    return mean


class Effect(ABC):
    """Physics that baseline leaves out. Subclasses set the class attributes and `columns`."""

    slug: str
    """Name in the catalogue, in files and in JSON."""
    title: str
    """A few words, for tables."""
    equation: str
    """The term, as it is added to the measured signals."""
    source: str
    """Where the equation and the typical size come from."""
    kind: EffectKind = "sensor"
    parameters: tuple[Parameter, ...]
    shape: tuple[ShapeParameter, ...] = ()
    follows: str
    """The variable that the residual follows: the abscissa of its plot."""
    regressor: tuple[str, str] | None = None
    """What one unit of a parameter adds to a channel, where that is a variable to plot against:
    label and unit, ``{axis}`` being the last letter of the parameter's name and ``{unit}`` that of
    the channel."""
    needs: str
    """What a recording must contain for the effect to be identified."""
    sentence: str
    """What a technician reads when it was found."""
    absorbed_by: tuple[str, ...] = ()
    """Groups of baseline parameters that take up part of it when it is left out."""
    rivals: tuple[str, ...] = ()
    """Effects whose columns overlap with its own on common recordings."""
    indivisible: bool = False
    """Whether its parameters are those of one vector in a frame whose axes say nothing of the
    sensor: they are there together, or not at all."""
    together: tuple[tuple[str, ...], ...] = ()
    """Sets of parameters of which one is there; by default any, all, or those that are alike."""
    from_moment: bool = False
    """Whether its one shape is a moment, from which on it acts as it would from the start."""
    from_power_on: bool = False
    """Whether it counts the time since the sensor was switched on."""
    reads: tuple[str, ...] = ()
    """Fields of `State` beyond the signals without which it has no columns."""

    @abstractmethod
    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return, for each linear parameter, what one unit of it adds to the signals.

        An empty dict means that the state lacks what the effect is a function of (no temperature).
        """

    def regressor_of(self, name: str) -> tuple[str, str] | None:
        """Return the label and the unit of `regressor` for one of its parameters."""
        if self.regressor is None:
            return None
        label, unit = self.regressor
        return label.format(axis=name[-1]), unit

    def reach(self, parameters: Mapping[str, float], *, interval: float) -> int:
        """Return how many samples on either side of one its correction looks at.

        ``interval`` is the time between samples, s. A stream is corrected in blocks that overlap by
        so many samples.
        """
        return 0

    def memory(self, parameters: Mapping[str, float], *, interval: float) -> int:
        """Return how many samples before one its correction looks at, if more than `reach`."""
        return self.reach(parameters, interval=interval)

    def must_show(self, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """Return the shape of the part of it that has to show, if it has one that is no proof.

        The rest may be there for reasons of its own.
        """
        return None

    def limits(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return the least and the most that some of its parameters can physically be, (p,) each.

        Of a term of the sensor that is `WORST` times what is typical, either way, where nothing
        else is said; an event or a setup may be of any size, and what refines others, too.
        """
        about = {p.name: p for p in self.parameters}
        far = WORST if self.kind == "sensor" else np.inf
        least, most = np.empty((2, len(names)))
        for k, p in enumerate(about[name] for name in names):
            own = np.inf if p.unit == PRESENCE or p.refining else far * p.typical
            least[k] = -own if p.least is None else p.least
            most[k] = own if p.most is None else p.most
        return least, most

    def too_small(self, values: FloatArray, covariance: FloatArray) -> bool:
        """Return whether all of its parameters, (p,), together are certainly less than they can be.

        Most effects can be as small as they like.
        """
        return False

    def is_form(self, shape: Mapping[str, float]) -> bool:
        """Return whether a shape's integers are a form that shows as none of the others does."""
        return True

    def in_words(self, shape: Mapping[str, float]) -> str:
        """Return the sentence that states its form (the values of its integers); empty for none."""
        return ""

    def size_if(self, common: float, *, gravity: float) -> float | None:
        """Return its size if it were what the scale factors of `absorbed_by` have in common.

        In proportion to it. None, as for most, if it would look different.
        """
        return None

    def contribution(self, state: State, parameters: Mapping[str, float]) -> dict[str, FloatArray]:
        """Return what the effect adds to each channel that it touches, with these parameters."""
        out: dict[str, FloatArray] = {}
        shape = {p.name: parameters[p.name] for p in self.shape if p.name in parameters}
        for name, column in self.columns(state, shape).items():
            value = parameters.get(name, 0.0)
            if not value:
                continue
            for channel, values in column.items():
                out[channel] = out[channel] + value * values if channel in out else value * values
        return out

    def typical(self, *, span: tuple[float, float]) -> dict[str, float]:
        """Return parameters of typical size on every axis; shapes in the middle of their range.

        Parameters
        ----------
        span : (start, stop), s
            Of the recording, where moments lie.

        Raises
        ------
        ValueError
            If a shape parameter has no typical value, such as a full scale.
        """
        out = {p.name: p.typical for p in self.parameters if p.unit != PRESENCE}
        for item in self.shape:
            if item.is_moment:
                out[item.name] = 0.5 * (span[0] + span[1])
            elif item.low is None or item.high is None:
                raise ValueError(f"{self.slug} has no typical `{item.name}`: give it")
            elif item.spacing == "log":
                out[item.name] = float(np.sqrt(item.low * item.high))
            elif not item.optional:
                out[item.name] = 0.5 * (item.low + item.high)
        if not out:
            names = ", ".join(item.name for item in self.shape)
            raise ValueError(f"{self.slug} has no typical parameters: give {names}")
        return out

    def check(self, parameters: Mapping[str, float]) -> None:
        """Check that `parameters` are this effect's own, can be, and lack no shape parameter.

        Raises
        ------
        ValueError
            Naming the parameter, what was expected of it and what came, or those that there are.
        """
        self.check_names(parameters)
        for name, value in parameters.items():
            if not np.isfinite(value):
                raise ValueError(f"`{name}` of {self.slug} must be finite, got {value}")
        for item in self.shape:
            if item.name in parameters:
                self._check_shape(item, parameters[item.name])
        missing = [p.name for p in self.shape if not p.optional and p.name not in parameters]
        if missing:
            raise ValueError(f"{self.slug} needs `{missing[0]}` as well")
        self._check_sizes(parameters)

    def check_names(self, names: Iterable[str]) -> None:
        """Check that these are parameters of this effect.

        Raises
        ------
        ValueError
            Naming the first that is not, and those that there are.
        """
        known = [p.name for p in self.parameters] + [p.name for p in self.shape]
        for name in names:
            if name not in known:
                raise ValueError(
                    f"`{name}` is no parameter of {self.slug}: it has {', '.join(known)}"
                )

    def _check_shape(self, item: ShapeParameter, value: float) -> None:
        if item.spacing == "integer" and value not in item.codes:
            span = f"{item.codes[0]} to {item.codes[-1]}"
            raise ValueError(f"`{item.name}` of {self.slug} must be {span}, got {value}")
        # Time constants, frequencies, counts and ranges.
        if item.spacing == "log" and value <= 0:
            raise ValueError(
                f"`{item.name}` of {self.slug} must be above 0 {item.unit}, got {value}"
            )

    def _check_sizes(self, parameters: Mapping[str, float]) -> None:
        """Check that whatever is there has a size, whose name begins with its own."""
        sizes = {
            p.name: [item.name for item in self.shape if item.name.startswith(f"{p.name}_")]
            for p in self.parameters
            if p.unit == PRESENCE
        }
        for name, own in sizes.items():
            if parameters.get(name) and not set(own) & set(parameters):
                raise ValueError(
                    f"`{name}` of {self.slug} is {parameters[name]:g} and has no size: give "
                    + " or ".join(f"`{size}`" for size in own)
                )
        every = [size for own in sizes.values() for size in own]
        if len(sizes) == len(self.parameters) and not set(every) & set(parameters):
            raise ValueError(
                f"{self.slug} has no size: give " + " or ".join(f"`{size}`" for size in every)
            )

    @property
    def is_readout(self) -> bool:
        """Whether it acts on the readout, and shows in samples: clipping, rounding, a unit."""
        return False

    def check_moments(self, parameters: Mapping[str, float], *, span: tuple[float, float]) -> None:
        """Check that moments are those of a recording that lasts from and to ``span``, s.

        Raises
        ------
        ValueError
            Naming the parameter, its value and the span.
        """
        for item in self.shape:
            value = parameters.get(item.name)
            if value is not None and item.is_moment and not span[0] <= value <= span[1]:
                raise ValueError(
                    f"`{item.name}` of {self.slug} must be in the recording, {span[0]:.6g} to "
                    f"{span[1]:.6g} s, got {value:.6g}"
                )

    def check_counts(self, parameters: Mapping[str, float], *, samples: float) -> None:
        """Check that numbers of samples are whole, and no more than the recording has.

        Raises
        ------
        ValueError
            Naming the parameter, its value and what is expected.
        """
        for name in (item.name for item in self.parameters if item.unit == SAMPLES):
            value = parameters.get(name, 0.0)
            if value != np.round(value):
                raise ValueError(
                    f"`{name}` of {self.slug} must be a whole number of samples, got {value:g}"
                )
            if abs(value) > samples:
                raise ValueError(
                    f"`{name}` of {self.slug} must be at most {samples:.0f}, the samples of the "
                    f"recording, got {value:g}"
                )


class TransformEffect(Effect):
    """An effect that acts on the finished signals rather than adding to them."""

    stage: Literal["signal", "readout"] = "signal"
    """``signal``: before the output noise is added (a delay, a low-pass); ``readout``: after it
    (clipping, rounding, a wrong unit)."""

    @abstractmethod
    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Return the signals with the effect in them."""

    @abstractmethod
    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        """Return the signals with the effect taken out, as far as that is possible."""

    @property
    def is_readout(self) -> bool:
        return self.stage == "readout"

    def ahead(self, parameters: Mapping[str, float], *, time: FloatArray) -> int:
        """Return how many samples at the end of (n,) times have no input: what is after the end."""
        return 0

    def restorer(
        self, signals: Signals, *, interval: float
    ) -> Callable[[Mapping[str, float]], Signals]:
        """Return what takes the effect out of noisy signals, where they stand out of the noise.

        They are sampled evenly, each `interval` s, and at rest at both ends. What the effect leaves
        alone comes back as the same array.
        """
        time = np.arange(0.0, len(signals.accel)) * interval
        return lambda parameters: self.inverse(time, signals, parameters)


@dataclass(frozen=True)
class Term:
    """One effect with its values: a part of a sensor model.

    ``parameters`` holds linear and shape parameters by name, in the units of the effect's file.
    """

    effect: str
    parameters: Mapping[str, float] = field(default_factory=dict)


def seconds_of_samples(seconds: float, interval: float) -> int:
    """Return how many samples of `interval` s reach over some seconds."""
    return int(np.ceil(seconds / interval)) if interval > 0 else 0


def per_axis(
    triad: str,
    prefix: str,
    unit: str,
    typical: float,
    *,
    refining: bool = False,
    most: float | None = None,
) -> tuple[Parameter, ...]:
    """Return one parameter for each axis of a triad: ``kx``, ``ky``, ``kz`` for prefix ``k``.

    None is larger than ``most``, either way.
    """
    least = None if most is None else -most
    return tuple(
        Parameter(f"{prefix}{a}", unit, typical, (f"{triad}.{a}",), False, refining, least, most)
        for a in AXES
    )


def axis_columns(triad: str, prefix: str, values: FloatArray) -> dict[str, Column]:
    """Return the columns of `per_axis` parameters: (n, 3) values, or (n,) for all axes alike."""
    return {
        f"{prefix}{a}": {f"{triad}.{a}": values if values.ndim == 1 else values[:, i]}
        for i, a in enumerate(AXES)
    }
