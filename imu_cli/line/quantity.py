"""Quantities as people write them in a station file: a number, a space, a unit."""

from __future__ import annotations

import math
import re

from calib.gravity import STANDARD_GRAVITY

_TO_SI: dict[str, tuple[str, float]] = {
    "m/s²": ("m/s²", 1.0),
    "m/s^2": ("m/s²", 1.0),
    "mm/s²": ("m/s²", 1e-3),
    "mm/s^2": ("m/s²", 1e-3),
    "g": ("m/s²", STANDARD_GRAVITY),
    "mg": ("m/s²", STANDARD_GRAVITY * 1e-3),
    "ug": ("m/s²", STANDARD_GRAVITY * 1e-6),
    "rad/s": ("rad/s", 1.0),
    "mrad/s": ("rad/s", 1e-3),
    "deg/s": ("rad/s", math.pi / 180),
    "dps": ("rad/s", math.pi / 180),
    "mdps": ("rad/s", math.pi / 180e3),
    "deg/h": ("rad/s", math.pi / 180 / 3600),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.pi / 180),
    "1": ("1", 1.0),
    "": ("1", 1.0),
    "%": ("1", 1e-2),
    "ppm": ("1", 1e-6),
    "°C": ("°C", 1.0),
    "C": ("°C", 1.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
}
_QUANTITY = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S*)\s*$")


def parse_quantity(text: str, *, unit: str) -> float:
    """Return a quantity such as ``"60 mg"`` in the SI unit that is wanted (``"m/s²"``).

    Raises
    ------
    ValueError
        If it is no number with a unit, or its unit measures something else.
    """
    value, measures = split_quantity(text)
    if measures != unit:
        known = ", ".join(name for name, (si, _) in _TO_SI.items() if si == unit and name)
        raise ValueError(f"{text!r} is not in units of {unit}; use one of {known}")
    return value


def split_quantity(text: str) -> tuple[float, str]:
    """Return a quantity's value in SI and that SI unit; ValueError if it is none."""
    found = _QUANTITY.match(text)
    if found is None:
        raise ValueError(f"{text!r} is no quantity: write a number and a unit, such as '3 %'")
    if found[2] not in _TO_SI:
        known = ", ".join(name for name in _TO_SI if name)
        raise ValueError(f"{text!r} has the unknown unit {found[2]!r}; known: {known}")
    unit, factor = _TO_SI[found[2]]
    return float(found[1]) * factor, unit
