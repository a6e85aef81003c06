"""Option values that several commands read the same way: durations, effects, gravity."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from calib.calibration import Gravity
    from calib.effects.base import Term

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


def parse_effect(text: str, *, span: tuple[float, float]) -> Term:
    """Return the term of ``slug:name=value,name=value`` in SI units, or of ``slug`` alone.

    Alone, or with shape parameters only, its linear parameters have their typical size.
    ValueError says what is wrong.
    """
    import difflib

    from calib.effects import effects
    from calib.effects.base import Term

    slug, _, rest = text.partition(":")
    if slug not in effects():
        near = difflib.get_close_matches(slug, effects(), n=1)
        hint = f": did you mean {near[0]}?" if near else f"; known: {', '.join(effects())}"
        raise ValueError(f"{slug!r} is no effect{hint}")
    effect = effects()[slug]
    given: dict[str, float] = {}
    for item in filter(None, rest.split(",")):
        name, equals, value = item.partition("=")
        try:
            given[name.strip()] = float(value)
        except ValueError:
            shown = "no number" if equals else "no value"
            raise ValueError(f"{item!r} in {text!r} has {shown}: give name=value") from None
    linear = {p.name for p in effect.parameters}
    if not linear & set(given):
        shape = {p.name for p in effect.shape}
        if not shape or not shape & set(given) or not all(p.optional for p in effect.shape):
            given = {**effect.typical(span=span), **given}
    effect.check(given)
    return Term(slug, given)


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
