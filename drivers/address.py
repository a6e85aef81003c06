"""Addresses of devices: ``scheme://target?option=value&option=value``.

::

    serial:///dev/ttyUSB0?dialect=witmotion&baud=115200     serial://COM3?dialect=auto
    i2c://1/0x68?chip=mpu6050&rate=1000
    replay://log.arrow?speed=1
    emulator://mpu6050?rate=200&seed=1

A target may hold ``%3F`` for a question mark, and so on, as in any URL.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from urllib.parse import unquote, unquote_plus

from calib.errors import AddressError


@dataclass(frozen=True)
class Address:
    """A parsed address. ``text`` is what the user wrote."""

    scheme: str
    target: str
    options: Mapping[str, str] = field(default_factory=dict)
    text: str = ""

    def check(self, known: Collection[str]) -> None:
        """Refuse an option that is none of the `known` ones.

        Raises
        ------
        AddressError
            It names the known options.
        """
        for key in self.options:
            if key not in known:
                close = difflib.get_close_matches(key, known, 1)
                hint = f" (did you mean {close[0]}?)" if close else ""
                names = ", ".join(sorted(known)) or "none"
                raise self.error(f"unknown option {key!r}{hint}; known here: {names}")

    def choice(self, key: str, allowed: Collection[str], default: str) -> str:
        """Return an option that must be one of the `allowed` words."""
        value = self.options.get(key, default)
        if value not in allowed:
            raise self.error(f"{key}={value} is not known; it can be {', '.join(sorted(allowed))}")
        return value

    def integer(self, key: str, default: int, *, minimum: int = 0) -> int:
        """Return an option as an integer (``0x`` is understood)."""
        text = self.options.get(key)
        if text is None:
            return default
        try:
            value = int(text, 0)
        except ValueError:
            raise self.error(f"{key}={text} is not a whole number") from None
        if value < minimum:
            raise self.error(f"{key}={text} must be at least {minimum}")
        return value

    def number(self, key: str, default: float, *, minimum: float = 0.0) -> float:
        """Return an option as a finite number."""
        text = self.options.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{key}={text} is not a number")
        if value < minimum:
            raise self.error(f"{key}={text} must be at least {minimum:g}")
        return value

    def error(self, what: str) -> AddressError:
        """Return an error that quotes this address."""
        return AddressError(f"address {self.text!r}: {what}")


def parse_address(text: str) -> Address:
    """Take an address apart.

    Raises
    ------
    AddressError
        If it has no scheme or no target, or an option is not ``key=value`` or stands twice.
    """
    scheme, separator, rest = text.partition("://")
    if not separator or not re.fullmatch(r"[a-z][a-z0-9+.-]*", scheme):
        raise AddressError(f"{text!r} is no device address{_suggest(text)}")
    target, _, query = rest.partition("?")
    address = Address(scheme, unquote(target), text=text)
    if not target:
        raise address.error(f"nothing stands after {scheme}://")
    options: dict[str, str] = {}
    for pair in filter(None, query.split("&")):
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise address.error(f"{pair!r} is not of the form option=value")
        if key in options:
            raise address.error(f"option {key!r} stands twice")
        options[key] = unquote_plus(value)
    return Address(scheme, address.target, MappingProxyType(options), text)


def _suggest(text: str) -> str:
    if text.startswith("/dev/tty") or re.fullmatch(r"(?i)COM\d+", text):
        return f"; for this port write serial://{text}"
    if re.search(r"\.\w+$", text):
        return f"; to play a file write replay://{text}"
    return (
        "; it looks like serial:///dev/ttyUSB0?dialect=auto, i2c://1/0x68?chip=mpu6050, "
        "replay://FILE or emulator://NAME"
    )
