"""The `Calibration`: a sensor model with its covariance, and all that one must know to trust it.

`calib.document` turns it into JSON and back; `drivers.calibration_file` reads and writes the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from calib.effects import effects
from calib.effects.base import Signals, State
from calib.fit import Exclusion, Fit
from calib.model import PARAMETER_UNITS, SensorModel
from calib.poses import Poses
from calib.recording import DeviceInfo
from calib.types import BoolArray, FloatArray

VERSION = "1.0"
"""Of the document. A new minor version only adds keys; a new major version changes meanings."""

Status = Literal["determined", "undetermined", "fixed"]
"""``determined``: estimated, with a standard error. ``undetermined``: the recording cannot tell, so
the value is the prior (0). ``fixed``: zero by the frame's definition or the method's model."""


@dataclass(frozen=True)
class Gravity:
    """The magnitude of gravity that was assumed, m/s², its standard error, and where it is from."""

    value: float
    source: str = "standard gravity"
    sigma: float = 0.0


@dataclass(frozen=True)
class TemperatureRange:
    """Lowest and highest temperature (°C) of the static poses that were fitted."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Noise:
    """White noise of each channel at rest: one-sided ``noise_density`` (3,) at ``rate`` Hz.

    Units are m/s²/√Hz and rad/s/√Hz; the per-sample standard deviation is ``N sqrt(rate / 2)``.
    """

    rate: float
    accel: FloatArray
    gyro: FloatArray


@dataclass(frozen=True, eq=False)
class TriadSummary:
    """How one triad was solved: what remains of a `Fit` beside its parameters and covariance.

    ``residuals`` (m, k) has one row per pose or turn, in ``residual_unit``, measured over
    ``intervals`` (m, 2), s.
    """

    method: str
    residuals: FloatArray
    residual_unit: str
    intervals: FloatArray
    degrees_of_freedom: int
    condition_number: float
    excluded: tuple[Exclusion, ...] = ()
    advice: tuple[str, ...] = ()

    @classmethod
    def from_fit(cls, fit: Fit) -> TriadSummary:
        """Return the summary of a solver's result."""
        return cls(
            fit.method,
            fit.residuals,
            fit.residual_unit,
            fit.intervals,
            fit.degrees_of_freedom,
            fit.condition_number,
            fit.excluded,
            fit.advice,
        )

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residuals that were used, in ``residual_unit`` (0 if none)."""
        rows = self.residuals[self.used]
        return float(np.sqrt(np.mean(rows**2))) if rows.size else 0.0

    @property
    def used(self) -> BoolArray:
        """Which rows of the residuals are of poses or turns that were not left out, (m,)."""
        used = np.ones(len(self.residuals), bool)
        for item in self.excluded:
            if item.weight == 0 and used.size:
                low, high = item.interval
                used &= ~((self.intervals[:, 0] >= low) & (self.intervals[:, 1] <= high))
        return used


@dataclass(frozen=True, eq=False)
class PoseTable:
    """What the sensor read in each static pose: (k, 2) s, (k, 3) m/s², (k, 3) rad/s, (k,) °C."""

    interval: FloatArray
    accel: FloatArray
    gyro: FloatArray
    temperature: FloatArray | None = None

    @classmethod
    def from_poses(cls, poses: Poses) -> PoseTable:
        """Keep the means of detected poses."""
        return cls(poses.interval, poses.accel, poses.gyro, poses.temperature)


@dataclass(frozen=True, eq=False)
class Housing:
    """Rotation from the sensor frame to the housing: ``vec_h = mat_hs @ vec_s``.

    ``sigma`` (3,) are the standard errors, rad, of small rotations about the housing's axes;
    ``residual_rms`` (rad) is the angle left between the poses and their faces.
    """

    mat_hs: FloatArray
    sigma: FloatArray
    residual_rms: float
    poses: int


@dataclass(frozen=True)
class Quantity:
    """A value with its standard error (None if unknown) and unit."""

    value: float
    sigma: float | None
    unit: str


@dataclass(frozen=True)
class Event:
    """What happened once in the recording that was fitted; it does not apply to other streams."""

    effect: str
    channels: tuple[str, ...]
    intervals: tuple[tuple[float, float], ...]
    parameters: Mapping[str, Quantity] = field(default_factory=dict)


@dataclass(frozen=True)
class InputFile:
    """A file that was calibrated from: its name, and the SHA-256 of its bytes in hexadecimal."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """Where a calibration comes from. ``date`` is ISO 8601 with its zone; "" if not recorded."""

    inputs: tuple[InputFile, ...] = ()
    tool_version: str = ""
    date: str = ""
    device: DeviceInfo = field(default_factory=DeviceInfo)
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A sensor model, its covariance, and what is known of how it came about.

    Parameters
    ----------
    model : SensorModel
        Baseline and further terms. What is not determined holds its prior value, 0.
    names : tuple of str
        The p determined parameters: ``accel.bias.x``, and ``effect.parameter`` for further terms.
    covariance : (p, p) array
        Of those parameters, in their units.
    undetermined : tuple of str
        Parameters that the method has but the recording does not determine.
    gravity : Gravity
    accel, gyro : TriadSummary or None
        How each triad was solved; None where it was not solved at all.
    temperature : TemperatureRange or None
        None if it was not measured.
    noise : Noise or None
    poses : PoseTable or None
    housing : Housing or None
        Where it is known, corrected signals are given in the housing's frame.
    events : tuple of Event
    provenance : Provenance
    version : str
        Of the document that it was read from.
    extra : mapping
        Top-level keys of a newer minor version, kept as they came.

    Raises
    ------
    ValueError
        If names and covariance disagree, or a name is not a parameter of the model.
    """

    model: SensorModel
    names: tuple[str, ...]
    covariance: FloatArray
    undetermined: tuple[str, ...]
    gravity: Gravity
    accel: TriadSummary | None = None
    gyro: TriadSummary | None = None
    temperature: TemperatureRange | None = None
    noise: Noise | None = None
    poses: PoseTable | None = None
    housing: Housing | None = None
    events: tuple[Event, ...] = ()
    provenance: Provenance = field(default_factory=Provenance)
    version: str = VERSION
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        covariance = np.array(self.covariance, np.float64)
        p = len(self.names)
        if covariance.shape != (p, p):
            raise ValueError(f"`covariance` must be {(p, p)} for {p} names, got {covariance.shape}")
        if not np.isfinite(covariance).all():
            raise ValueError("`covariance` must be finite: it holds determined parameters only")
        if p and np.diag(covariance).min() < 0:
            raise ValueError("`covariance` has a negative variance on its diagonal")
        scale = np.sqrt(np.diag(covariance))
        if (np.abs(covariance - covariance.T) > 1e-6 * np.outer(scale, scale)).any():
            raise ValueError("`covariance` must be symmetric")
        known = self.values
        for label, names in (("names", self.names), ("undetermined", self.undetermined)):
            if len(set(names)) != len(names):
                raise ValueError(f"`{label}` has a name twice")
            for name in names:
                if name not in known:
                    raise ValueError(f"`{label}`: {name!r} is no parameter of the model")
        if both := set(self.names) & set(self.undetermined):
            raise ValueError(f"`undetermined` has {sorted(both)}, which `names` has too")
        covariance.flags.writeable = False
        object.__setattr__(self, "covariance", covariance)

    @property
    def values(self) -> dict[str, float]:
        """Every parameter of the model by name: 24 of baseline, then those of further terms."""
        values = self.model.accel.parameters("accel") | self.model.gyro.parameters("gyro")
        for term in self.model.terms:
            values |= {f"{term.effect}.{name}": value for name, value in term.parameters.items()}
        return values

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard error of each determined parameter, by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def complete(self) -> bool:
        """True if nothing is undetermined."""
        return not self.undetermined

    def status(self, name: str) -> Status:
        """Return whether a parameter is determined, undetermined or fixed."""
        if name in self.names:
            return "determined"
        return "undetermined" if name in self.undetermined else "fixed"

    def correct(self, measured: State) -> Signals:
        """Return the true signals, in the housing's frame if that is known."""
        signals = self.model.correct(measured)
        if self.housing is None:
            return signals
        mat_sh = self.housing.mat_hs.T
        return Signals(signals.accel @ mat_sh, signals.gyro @ mat_sh)

    def with_provenance(self, provenance: Provenance) -> Calibration:
        """Return a copy that says where it comes from."""
        return replace(self, provenance=provenance)


def parameter_unit(name: str) -> str:
    """Return the unit of a parameter by its full name; ValueError if there is none such."""
    group = name.rsplit(".", 1)[0]
    if group in PARAMETER_UNITS:
        return PARAMETER_UNITS[group]
    slug, _, parameter = name.partition(".")
    if slug not in effects():
        raise ValueError(f"`name` {name!r} is no parameter that imu-cal knows")
    effect = effects()[slug]
    units = {item.name: item.unit for item in effect.parameters}
    units |= {item.name: item.unit for item in effect.shape}
    if parameter in units:
        return units[parameter]
    raise ValueError(f"`name` {name!r} is no parameter of {slug}")
