"""Registries that fill from their folder: one file each, found by itself."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from typing import TypeVar

T = TypeVar("T")


def discover(
    package: str, path: Iterable[str], *, attribute: str, kind: type[T], key: str
) -> dict[str, T]:
    """Import every module of a package and return its objects named `attribute` by their `key`.

    Modules without the attribute (``base``, helpers) are passed over.

    Raises
    ------
    TypeError
        If the attribute is not a `kind`.
    ValueError
        If two modules claim one key.
    """
    found: dict[str, T] = {}
    for info in sorted(pkgutil.iter_modules(path), key=lambda info: info.name):
        module = importlib.import_module(f"{package}.{info.name}")
        item = getattr(module, attribute, None)
        if item is None:
            continue
        if not isinstance(item, kind):
            raise TypeError(f"{module.__name__}.{attribute} must be a {kind.__name__}")
        name = getattr(item, key)
        if name in found:
            raise ValueError(f"{module.__name__} claims {key} {name!r}, which is taken")
        found[name] = item
    return found
