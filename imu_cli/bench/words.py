"""Poses and turns in the words of someone who holds the sensor in the hand."""

from __future__ import annotations

from itertools import product

import numpy as np

from calib.planning import Action
from calib.recording import AXES
from calib.types import FloatArray

_DIRECTIONS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)], np.float64)
_UNIT = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


def faces(direction: FloatArray) -> list[str]:
    """Return the faces, such as ``+Y``, of the nearest face, edge or corner to a direction."""
    nearest = _DIRECTIONS[int(np.argmax(_UNIT @ direction))]
    return [f"{'+' if v > 0 else '-'}{AXES[k].upper()}" for k, v in enumerate(nearest) if v]


def describe_pose(up: FloatArray) -> str:
    """Say how the sensor stands when up is at `up` (unit, frame s)."""
    down = faces(-up)
    if len(down) == 1:
        return f"the {down[0]} face is down"
    place = "edge" if len(down) == 2 else "corner"
    return f"it stands on the {place} of {', '.join(down[:-1])} and {down[-1]}"


def describe_axis(axis: FloatArray) -> str:
    """Say which axis of the sensor a direction (unit, frame s) is."""
    names = faces(axis)
    if len(names) == 1:
        return f"its {names[0]} axis"
    return f"the diagonal between {' and '.join(names)}"


def instruction(action: Action) -> str:
    """Say what to do, in one sentence."""
    angle = round(np.degrees(abs(action.angle)))
    axis = action.axis * np.sign(action.angle)
    return (
        f"Turn it by {angle:d}° about {describe_axis(axis)}, until {describe_pose(action.up)}; "
        "then hold it still for 3 s."
    )


def turn_rule(action: Action) -> str:
    """Say which way round."""
    axis = faces(action.axis * np.sign(action.angle))
    return f"Right thumb along {' and '.join(axis)}: turn the way the fingers curl."
