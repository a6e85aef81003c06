"""What a transport is: a URL scheme and a way to make the driver behind it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.address import Address
from drivers.driver import Driver


@dataclass(frozen=True)
class Transport:
    """One file in this folder sets ``TRANSPORT`` to one of these.

    ``make`` does no I/O: it checks the address and its options and returns an unopened driver.
    """

    scheme: str
    example: str
    make: Callable[[Address], Driver]
