"""A JSON document that checks what it holds and says where it is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.errors import CalibrationFileError
from calib.types import FloatArray


class Node:
    """A place in a document, which checks what it holds and names itself in messages."""

    def __init__(self, content: object, path: str) -> None:
        self.content = content
        self.path = path

    def mapping(self) -> Mapping[str, Any]:
        if not isinstance(self.content, dict):
            raise self._error("an object", self.content)
        return self.content

    def get(self, key: str) -> Any:
        return self.mapping().get(key)

    def child(self, key: str) -> Node:
        content = self.mapping()
        path = f"{self.path}.{key}" if self.path else key
        if key not in content:
            raise CalibrationFileError(f"the calibration lacks `{path}`: was the file edited?")
        return Node(content[key], path)

    def optional(self, key: str) -> Node | None:
        return None if self.get(key) is None else self.child(key)

    def items(self, key: str) -> list[Node]:
        node = self.child(key)
        if not isinstance(node.content, list):
            raise node._error("a list", node.content)
        return [Node(item, f"{node.path}[{k}]") for k, item in enumerate(node.content)]

    def text(self, key: str) -> str:
        node = self.child(key)
        if not isinstance(node.content, str):
            raise node._error("a string", node.content)
        return node.content

    def texts(self, key: str) -> tuple[str, ...]:
        items = self.items(key)
        for item in items:
            if not isinstance(item.content, str):
                raise item._error("a string", item.content)
        return tuple(str(item.content) for item in items)

    def number(self, key: str) -> float:
        node = self.child(key)
        value = node.content
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise node._error("a finite number", value)
        return float(value)

    def least(self, key: str, low: float) -> float:
        """Return a number that is not below `low`."""
        value = self.number(key)
        if value < low:
            raise self.child(key)._error(f"{low:g} or more", value)
        return value

    def unit(self, expected: str) -> None:
        unit = self.text("unit")
        if unit != expected:
            raise CalibrationFileError(
                f"`{self.path}` has the unit {unit!r}, expected {expected!r}: "
                "convert the value, or recalibrate"
            )

    def quantity(self, unit: str) -> float:
        self.unit(unit)
        return self.number("value")

    def pair(self, key: str) -> tuple[float, float]:
        low, high = self.array(key, (2,))
        return float(low), float(high)

    def array(self, key: str, shape: Sequence[int | None]) -> FloatArray:
        node = self.child(key)
        try:
            values = np.array(node.content, np.float64)
        except (TypeError, ValueError) as error:
            raise node._error("numbers", node.content) from error
        if values.size == 0 and shape[0] in (None, 0):
            values = np.zeros([n or 0 for n in shape])
        if values.ndim != len(shape) or any(
            n is not None and n != m for n, m in zip(shape, values.shape, strict=False)
        ):
            wanted = " x ".join("n" if n is None else str(n) for n in shape)
            raise node._error(f"{wanted} numbers", f"shape {values.shape}")
        if not np.isfinite(values).all():
            raise node._error("finite numbers", node.content)
        values.flags.writeable = False
        return values

    def _error(self, expected: str, seen: object) -> CalibrationFileError:
        shown = repr(seen)
        shown = shown if len(shown) <= 60 else shown[:57] + "..."
        where = f"`{self.path}`" if self.path else "the document"
        return CalibrationFileError(f"{where} must be {expected}, found {shown}")
