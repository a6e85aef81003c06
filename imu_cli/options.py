"""Option values that several commands read the same way: durations, gravity."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from calib.calibration import Gravity

_UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0, "ms": 1e-3}


def parse_duration(text: str) -> float:
    """Return seconds of ``90``, ``90s``, ``10min`` or ``1.5h``; ValueError otherwise."""
    match = re.fullmatch(r"\s*([0-9.]+(?:[eE][+-]?\d+)?)\s*(ms|s|min|h|)\s*", text)
    try:
        value = float(match[1]) * _UNITS[match[2]] if match else 0.0
    except ValueError:
        value = 0.0
    if not value > 0:
        raise ValueError(f"{text!r} is no duration: give 90s, 10min or 1.5h")
    return value


def choose_gravity(gravity: float | None, latitude: float | None, height: float | None) -> Gravity:
    """Return local gravity from ``--gravity``, or from ``--latitude`` (°) and ``--height`` (m)."""
    from calib.calibration import Gravity
    from calib.gravity import ANOMALY, STANDARD_GRAVITY, normal_gravity

    if gravity is not None:
        if latitude is not None or height is not None:
            raise typer.BadParameter("give --gravity, or --latitude and --height, not both")
        if not 9.7 < gravity < 9.9:
            raise typer.BadParameter(
                f"expected m/s² between 9.7 and 9.9, got {gravity:g}", param_hint="--gravity"
            )
        return Gravity(gravity, "given")
    if latitude is None:
        if height is not None:
            raise typer.BadParameter("needs --latitude beside it", param_hint="--height")
        return Gravity(STANDARD_GRAVITY, "standard gravity")
    try:
        value = normal_gravity(math.radians(latitude), height or 0.0)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--latitude, --height") from error
    return Gravity(value, f"normal gravity at {latitude:g}°, {height or 0:g} m", ANOMALY)
