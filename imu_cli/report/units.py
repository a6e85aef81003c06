"""Units that people know: what is SI inside is shown as mg, dps, % and degrees."""

from __future__ import annotations

import math

from calib.calibration import parameter_unit
from calib.gravity import STANDARD_GRAVITY

_BASE = {"m/s²": ("mg", 1e3 / STANDARD_GRAVITY), "rad/s": ("dps", 180 / math.pi)}

_PEOPLE = {
    **_BASE,
    "rad": ("°", 180 / math.pi),
    "1": ("%", 100.0),
    "1/K": ("%/K", 100.0),
    "m": ("mm", 1e3),
    "s²": ("ms²", 1e6),
    "(rad/s)/(m/s²)": ("dps/g", 180 / math.pi * STANDARD_GRAVITY),
    "(rad/s)/(m/s²)²": ("dps/g²", 180 / math.pi * STANDARD_GRAVITY**2),
    "(m/s²)/(m/s²)²": ("mg/g²", 1e3 * STANDARD_GRAVITY),
    "(m/s²)/(m/s²)³": ("mg/g³", 1e3 * STANDARD_GRAVITY**2),
    **{
        f"({unit})/{per}": (f"{name}/{per}", factor)
        for unit, (name, factor) in _BASE.items()
        for per in ("K", "K²", "K³", "(K/s)", "(K/sample)")
    },
}


def people_unit(unit: str) -> tuple[str, float]:
    """Return the unit that people use for an SI unit, and the factor to it (itself if none)."""
    return _PEOPLE.get(unit, (unit, 1.0))


def with_error(value: float, error: float | None, unit: str) -> tuple[str, str, str]:
    """Return value, standard error and unit as people write them, to the error's second digit."""
    name, factor = people_unit(unit)
    value *= factor
    if error is None or not math.isfinite(error) or error <= 0:
        return f"{value:.5g}", "-", name
    error *= factor
    digits = max(0, 1 - math.floor(math.log10(error)))
    if digits > 9:
        return f"{value:.6g}", f"{error:.2g}", name
    return f"{value:.{digits}f}", f"{error:.{digits}f}", name


def said(value: float, sigma: float | None, unit: str) -> str:
    """Return `with_error` as words of a sentence."""
    number, spread, name = with_error(value, sigma, unit)
    return (number if spread == "-" else f"{number} ± {spread}") + (f" {name}" if name else "")


def parameter_text(name: str, value: float, error: float | None) -> tuple[str, str, str]:
    """Return `with_error` for a parameter by its full name."""
    return with_error(value, error, parameter_unit(name))
