"""Register maps of I2C chips: one file each, with one ``CHIP``.

To add a chip, add a file here with a `Chip` named ``CHIP`` and its model from the other side of the
wire in ``drivers/emulators/chips``. ``scan``, ``chip=auto``, ``flash``, the emulated buses and
``tests/test_registry.py`` find it by itself.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from calib.registry import discover
from drivers.chips.base import Chip


@cache
def chips() -> dict[str, Chip]:
    """Return every chip family by its name, in alphabetical order of their files."""
    kind: Any = Chip  # mypy takes only concrete classes for type[T]
    return discover(__name__, __path__, attribute="CHIP", kind=kind, key="name")


def get_chip(name: str) -> Chip:
    """Return a chip family by its own name or by that of a part (``mpu9250``, ``lsm6dsox``).

    Raises
    ------
    ValueError
        If there is none; the message names them all.
    """
    wanted = normal_name(name)
    for chip in chips().values():
        if wanted in map(normal_name, (chip.name, *chip.models.values(), *chip.aliases)):
            return chip
    known = ", ".join(
        part for chip in chips().values() for part in (*chip.models.values(), *chip.aliases)
    )
    raise ValueError(f"`chip` {name!r} is not known: {known}")


def normal_name(name: str) -> str:
    """Return a chip's name without case and punctuation: ICM-42688-P is icm42688p."""
    return "".join(letter for letter in name.lower() if letter.isalnum())
