"""I2C chips seen from the bus: one file each, with one ``MODEL``."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from drivers.chips import get_chip, normal_name
from drivers.emulators.chips.base import ChipModel


@cache
def chip_models() -> dict[str, type[ChipModel]]:
    """Return every emulated chip family by the name of its `drivers.chips` family."""
    found: dict[str, type[ChipModel]] = {}
    for info in pkgutil.iter_modules(__path__):
        model = getattr(importlib.import_module(f"{__name__}.{info.name}"), "MODEL", None)
        if model is not None:
            found[model.chip_name] = model
    return found


def resolve(name: str) -> tuple[type[ChipModel], str]:
    """Return the model and the part that a name stands for (``mpu9250`` is an MPU-6500's part).

    Raises
    ------
    ValueError
        If no chip has that name.
    """
    chip = get_chip(name)
    parts = chip.models.values()
    part = next((p for p in parts if normal_name(p) == normal_name(name)), next(iter(parts)))
    return chip_models()[chip.name], part
