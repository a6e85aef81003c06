"""Options that several commands have in common, and how their values are read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calib.calibration import Gravity

ProfileOption = Annotated[
    str | None, typer.Option(help="Import profile of a foreign log: a name, or a .toml file.")
]
ImuOption = Annotated[int | None, typer.Option(help="Which sensor of a board, from 1.")]
DropInvalidOption = Annotated[bool, typer.Option(help="Turn rows that are not finite into gaps.")]
FixedPointOption = Annotated[
    bool,
    typer.Option(
        "--fixed-point",
        help="REF has orientations only, and the body turned about a fixed point: a table of "
        "several axes. (One axis, angles and rates are known to.)",
    ),
]
GravityOption = Annotated[
    float | None, typer.Option(help="Local gravity, m/s²  [default: 9.80665]")
]
LatitudeOption = Annotated[
    float | None, typer.Option(help="Latitude, °: gravity by the normal-gravity formula.")
]
HeightOption = Annotated[
    float | None, typer.Option(help="Height, m, with --latitude  [default: 0]")
]

_UNITS = {"": 1.0, "ms": 1e-3, "s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


def parse_duration(text: str) -> float:
    """Return seconds of ``90s``, ``10min`` or ``1.5h``; a bare number is seconds.

    ValueError if it is no such thing, or not positive.
    """
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)", text.strip())
    unit = None if match is None else _UNITS.get(match[2])
    if match is None or unit is None or float(match[1]) <= 0:
        raise ValueError(
            f"{text!r} is no duration; write a positive number and a unit, as in 90s, 10min, 1h"
        )
    return float(match[1]) * unit


def refuse_source(
    out: Path, sources: Iterable[Path], *, what: str = "recording", hint: str = "--output"
) -> None:
    """Refuse to write over what is read, under whichever of its names, and to write to ``-``."""
    if str(out) == "-":
        raise typer.BadParameter(
            "- is no file: name one (standard output has what is said, and --json)", param_hint=hint
        )
    for path in sources:
        if _one_file(out, path):
            raise typer.BadParameter(f"{out} is the {what} itself", param_hint=hint)


def refuse_overwriting(
    outputs: Mapping[str, Path | None], sources: Iterable[tuple[str, Path | None]]
) -> None:
    """Refuse outputs, by their options, that write over a source, or over each other."""
    made = [(hint, path) for hint, path in outputs.items() if path is not None]
    for k, (hint, path) in enumerate(made):
        refuse_source(path, [], hint=hint)
        for what, source in sources:
            if source is not None:
                refuse_source(path, [source], what=what, hint=hint)
        for other, earlier in made[:k]:
            if _one_file(path, earlier):
                raise typer.BadParameter(
                    f"{path} is that of {other}, too: give two files", param_hint=hint
                )


def _one_file(first: Path, second: Path) -> bool:
    same = first.resolve() == second.resolve()
    return same or (first.exists() and second.exists() and first.samefile(second))


def replayed(url: str) -> list[Path]:
    """Return the file that a device's address plays, if it is that of a replay."""
    from drivers.address import parse_address

    address = parse_address(url)
    return [Path(address.target)] if address.scheme == "replay" else []


def choose_gravity(gravity: float | None, latitude: float | None, height: float | None) -> Gravity:
    """Return local gravity from ``--gravity``, or from ``--latitude`` (°) and ``--height`` (m)."""
    from calib.calibration import Gravity
    from calib.gravity import ANOMALY, EARTH, STANDARD_GRAVITY, normal_gravity

    if gravity is not None:
        if latitude is not None or height is not None:
            raise typer.BadParameter("give --gravity, or --latitude and --height, not both")
        if not EARTH[0] < gravity < EARTH[1]:
            raise typer.BadParameter(
                f"expected m/s² between {EARTH[0]} and {EARTH[1]}, got {gravity:g}",
                param_hint="--gravity",
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
