"""Compare two calibrations of one device: which parameters differ, in standard errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, stdtr

from calib.allowance import between
from calib.calibration import Calibration, parameter_unit
from calib.model import Triad
from calib.recording import DeviceInfo
from calib.types import FloatArray

SIGNIFICANCE = 0.001
"""Chance that two calibrations of an unchanged device are called different."""


@dataclass(frozen=True)
class Difference:
    """One parameter in both: the second less the first, its standard error, and their ratio.

    The standard errors were estimated with so many ``degrees_of_freedom``.
    """

    name: str
    first: float
    second: float
    sigma: float
    unit: str
    degrees_of_freedom: float
    allowance: float = 0.0

    @property
    def difference(self) -> float:
        """Second less first."""
        return self.second - self.first

    @property
    def score(self) -> float:
        """The difference in standard errors."""
        return self.difference / self.sigma if self.sigma > 0 else 0.0

    @property
    def p_value(self) -> float:
        """Two-sided, for this parameter alone, by Student's t."""
        return float(2 * stdtr(self.degrees_of_freedom, -abs(self.score)))


@dataclass(frozen=True)
class Comparison:
    """What differs between two calibrations.

    ``differences`` are of the parameters that both determine; ``p_value`` is that of all of them
    together (Hotelling's test: chi-square of ``rank`` with the covariance of both, whose size is
    estimated too); ``only_first`` and ``only_second`` name what
    one alone determines; ``identity`` says where they are of different devices, or "".
    """

    differences: tuple[Difference, ...]
    chi_square: float
    rank: int
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    identity: str
    significance: float = SIGNIFICANCE

    @property
    def p_value(self) -> float:
        """Of all parameters together; 1 if there is none in common."""
        if not self.rank:
            return 1.0
        freedom = min(item.degrees_of_freedom for item in self.differences)
        return float(fdtrc(self.rank, freedom, self.chi_square / self.rank))

    @property
    def changed(self) -> tuple[Difference, ...]:
        """Parameters that differ by themselves, corrected for their number, the worst first."""
        limit = self.significance / max(1, len(self.differences))
        found = [d for d in self.differences if d.p_value < limit]
        return tuple(sorted(found, key=lambda d: -abs(d.score)))

    @property
    def same(self) -> bool:
        """True if neither all parameters together nor any by itself differ."""
        return self.p_value >= self.significance and not self.changed


def compare(first: Calibration, second: Calibration) -> Comparison:
    """Compare two calibrations of one device.

    Both are brought to one gravity first: what one assumed is in its scale factors. Angles of the
    gyroscope are the same as a term (`aligned`). To both covariances comes what a sensor may do by
    itself in between (`calib.allowance.between`).
    """
    first, second = aligned(first), aligned(second)
    ratio = second.gravity.value / first.gravity.value
    if ratio != 1.0:
        # measured = T true, and true is in proportion to the gravity that was assumed.
        accel = second.model.accel
        moved = Triad.from_matrix(accel.matrix * ratio, accel.bias)
        second = replace(second, model=replace(second.model, accel=moved))
    common = [name for name in first.names if name in second.names]
    allowed = between(first, second)
    moves = np.array([allowed.get(name, 0.0) for name in common])
    one, two = _values(first, common), _values(second, common)
    covariance = _part(first, common) + _part(second, common) + np.diag(moves**2)
    sigma = np.sqrt(np.diag(covariance))
    difference = two - one
    known = sigma > 0
    scaled_covariance = covariance[np.ix_(known, known)] / np.outer(sigma[known], sigma[known])
    scaled = difference[known] / sigma[known]
    square = float(scaled @ np.linalg.lstsq(scaled_covariance, scaled, rcond=1e-10)[0])
    return Comparison(
        tuple(
            Difference(
                name,
                float(one[k]),
                float(two[k]),
                float(sigma[k]),
                parameter_unit(name),
                _freedom(name, first, second),
                float(moves[k]),
            )
            for k, name in enumerate(common)
        ),
        square,
        int(np.linalg.matrix_rank(scaled_covariance, tol=1e-10)) if known.any() else 0,
        tuple(name for name in first.names if name not in second.names),
        tuple(name for name in second.names if name not in first.names),
        device_mismatch(first.provenance.device, second.provenance.device),
    )


def aligned(calibration: Calibration) -> Calibration:
    """Return the calibration with its misalignment in the triad, if `diagnose` made it a term.

    ``M w`` is the same in either place.
    """
    slug, group = "gyro_misalignment", "gyro.misalignment."
    named = (*calibration.names, *calibration.undetermined)
    terms = [term for term in calibration.model.terms if term.effect == slug]
    if not terms or any(name.startswith(group) for name in named):
        return calibration
    values = calibration.model.gyro.parameters("gyro")
    moved = {
        f"{group}{name[1:]}": values[f"{group}{name[1:]}"] + value
        for name, value in terms[0].parameters.items()
    }
    model = replace(
        calibration.model,
        gyro=calibration.model.gyro.with_parameters(moved),
        terms=tuple(term for term in calibration.model.terms if term.effect != slug),
    )

    def renamed(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name.replace(f"{slug}.m", group) for name in names)

    return replace(
        calibration,
        model=model,
        names=renamed(calibration.names),
        undetermined=renamed(calibration.undetermined),
    )


def device_mismatch(calibrated: DeviceInfo, seen: DeviceInfo) -> str:
    """Return how two devices differ, or "" where nothing says that they do."""
    for label, a, b in (
        ("chip", calibrated.chip, seen.chip),
        ("serial number", calibrated.serial_number, seen.serial_number),
    ):
        if a and b and a != b:
            return f"the {label} is {b}, that of the calibration {a}"
    return ""


def _values(calibration: Calibration, names: list[str]) -> FloatArray:
    values = calibration.values
    return np.array([values[name] for name in names])


def _part(calibration: Calibration, names: list[str]) -> FloatArray:
    index = [calibration.names.index(name) for name in names]
    return calibration.covariance[np.ix_(index, index)]


def _freedom(name: str, first: Calibration, second: Calibration) -> float:
    """Return the degrees of freedom of a difference's standard error, after Satterthwaite.

    Those of either fit are its residuals, less nine for the parameters of a matrix.
    """
    variances, parts = 0.0, 0.0
    for calibration in (first, second):
        variance = calibration.sigmas[name] ** 2
        summary = calibration.gyro if name.startswith("gyro") else calibration.accel
        freedom = np.inf
        if summary is not None and summary.residuals.size:
            freedom = max(1.0, float(summary.residuals[summary.used].size - 9))
        variances += variance
        parts += variance**2 / freedom
    return float(variances**2 / parts) if parts > 0 else 1e9
