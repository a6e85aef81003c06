"""Headers that say by themselves what their columns are, units and all: no profile is needed.

``time (s), acc x (m/s²), ... gyr z (deg/s)``, or ``t_us, ax_g, ... gz_dps, temp_c``: a name says
the quantity and the axis, and its unit stands in brackets or at its end. Nothing is assumed: with a
unit that is missing, an axis twice, or three axes in two units the header says too little.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from calib.recording import AXES
from drivers.formats.profile import Profile, make_profile

NAME = "header"
"""Of the profile that a header makes."""

EXAMPLE = "time (s), acc x (m/s^2), ... gyr z (deg/s)"
"""A header that says enough."""

_TRIADS = {
    "accel": r"(?:a|acc|accel|accelerometer|acceleration)",
    "gyro": r"(?:g|w|gyr|gyro|gyroscope|omega|angularvelocity|angularrate)",
}
_SCALARS = {
    "time": r"(?:t|time|timestamp|elapsed|elapsedtime|timeelapsed|sampletime|)",
    "temperature": r"(?:t|temp|temperature)",
}
_SPELLED = {
    "accel": {
        "m/s^2": ("m/s2", "m/s/s", "ms-2", "mps2"),
        "g": ("g",),
        "mg": ("mg",),
    },
    "gyro": {
        "rad/s": ("rad/s", "rads-1", "radps", "rad/sec"),
        "deg/s": ("deg/s", "°/s", "dps", "degps", "degs-1", "deg/sec"),
        "mdeg/s": ("mdeg/s", "mdps"),
    },
    "time": {
        "s": ("s", "sec", "secs", "second", "seconds"),
        "ms": ("ms", "msec", "millis", "milliseconds"),
        "us": ("us", "µs", "usec", "micros", "microseconds"),
        "ns": ("ns", "nsec", "nanos", "nanoseconds"),
    },
    "temperature": {
        "degC": ("c", "°c", "degc", "celsius"),
        "degF": ("f", "°f", "degf", "fahrenheit"),
        "K": ("k", "kelvin"),
    },
}
UNITS = {
    quantity: {spelled: unit for unit, every in units.items() for spelled in every}
    for quantity, units in _SPELLED.items()
}
"""The unit that a spelling means, by quantity: as a profile has it."""

_BRACKETS = re.compile(r"^(.*?)\s*[(\[]\s*([^()\[\]]*?)\s*[)\]]$")
_SIGNS = str.maketrans({"^": "", "*": "", "·": "", " ": "", "²": "2", "⁻": "-", "¹": "1", "μ": "µ"})
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")


def profile_of_header(names: Sequence[str], first: Sequence[str] = ()) -> Profile | None:
    """Return the profile that the names of columns make; None where they say too little.

    Parameters
    ----------
    names : sequence of str
        As they stand in the header, without quotes.
    first : sequence of str
        The first row of samples, likewise, if there is one: a time without a unit may be a date
        there.
    """
    found: dict[tuple[str, str], tuple[str, str]] = {}
    for position, name in enumerate(names):
        known = column_of(name)
        if known is None and position < len(first) and _DATE.match(first[position]):
            known = _dated(name)
        if known is None:
            continue
        quantity, axis, unit = known
        if (quantity, axis) in found:
            return None
        found[quantity, axis] = name, unit
    if ("time", "") not in found:
        return None
    values: dict[str, Any] = {"description": "as the header of the file says"}
    values["text"] = {"header": True}
    for quantity in _TRIADS:
        own = [found.get((quantity, axis)) for axis in AXES]
        units = {unit for _, unit in filter(None, own)}
        if None in own or len(units) != 1:
            return None
        values[quantity] = {"columns": [name for name, _ in filter(None, own)], "unit": units.pop()}
    for quantity in _SCALARS:
        if (quantity, "") in found:
            name, unit = found[quantity, ""]
            values[quantity] = {"column": name, "unit": unit}
    return make_profile(values, name=NAME)


def column_of(name: str) -> tuple[str, str, str] | None:
    """Return the quantity, axis ('' for none) and unit that a column's name says, if it does."""
    for base, unit in _splits(name):
        for quantity, axis in _meanings(base):
            if (known := UNITS[quantity].get(unit)) is not None:
                return quantity, axis, known
    return None


def _dated(name: str) -> tuple[str, str, str] | None:
    """Return what a column of dates is, if its name is that of a time."""
    return ("time", "", "iso8601") if ("time", "") in _meanings(name) else None


def _splits(name: str) -> list[tuple[str, str]]:
    """Return the ways to part a name from its unit: at brackets, or before its last words."""
    if match := _BRACKETS.match(name):
        return [(match[1], _plain(match[2]))]
    words = [w for w in re.split(r"[\s_]+", name) if w and w.lower() != "per"]
    return [
        (" ".join(words[:at]), _plain("/".join(words[at:])))
        for at in range(max(len(words) - 2, 0), len(words))
    ]


def _plain(unit: str) -> str:
    """Return a unit as `UNITS` spells it."""
    return unit.translate(_SIGNS).lower()


def _meanings(base: str) -> list[tuple[str, str]]:
    """Return the quantities, and axes, that a name without a unit may stand for."""
    plain = re.sub(r"[^a-z0-9]", "", base.lower()).removeprefix("imu")
    out = [(quantity, "") for quantity, form in _SCALARS.items() if re.fullmatch(form, plain)]
    for quantity, form in _TRIADS.items():
        match = re.fullmatch(f"{form}([xyz])|([xyz]){form}", plain)
        if match:
            out.append((quantity, match[1] or match[2]))
    return out
