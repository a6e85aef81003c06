"""The Earth's rotation, which a gyro at rest senses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.effects.base import Column, Effect, Parameter, State
from calib.recording import AXES
from calib.types import FloatArray

RATE = 7.2921150e-5
"""rad/s, relative to the stars (IERS Conventions 2010, table 1.2)."""


SURE = 3.0
"""Standard errors by which a rotation must be faster than the Earth's, or slower, to be none."""

SLOW = 0.5
"""Share of the Earth's rate that is seen at least: a heading that drifts as it is integrated turns
north away, by less than a radian."""


class EarthRate(Effect):
    """``w_m += mat_sn (east, north, up)``."""

    slug = "earth_rate"
    title = "Earth rate"
    equation = "w_m += mat_sn (east, north, up)"
    source = (
        "IERS Conventions (2010): 7.2921150e-5 rad/s; its north part goes with the cosine "
        "of latitude, its part up with the sine. At 45 degrees each is 5.16e-5 rad/s, 3 "
        "mdps"
    )
    kind = "setup"
    parameters = tuple(
        Parameter(
            name,
            "rad/s",
            RATE / np.sqrt(2),
            ("gyro.x", "gyro.y", "gyro.z"),
            least=-RATE,
            most=RATE,
        )
        for name in ("east", "north", "up")
    )
    follows = "heading and tilt at rest"
    needs = (
        "a quiet gyro, long statics, several headings, so that its north part shows; its part up "
        "looks like an isotropic g-sensitivity, but is 15.04 degrees an hour times the sine of "
        "the latitude: compare the two"
    )
    sentence = (
        "The gyro at rest senses the Earth's rotation. Where east is the recording does not know: "
        "east and north together are its part along the ground."
    )
    absorbed_by = ("gyro.bias",)
    rivals = ("gyro_g_sensitivity",)
    indivisible = True
    reads = ("mat_ns",)

    def excess(self, values: Mapping[str, float], sigmas: Mapping[str, float]) -> float:
        """Return how many times as fast as the Earth a rotation (rad/s) is, if that is certain.

        That is by three standard errors; else 1. What is beyond the Earth is in its part up, or is
        no rotation.
        """
        rate = np.array([values[p.name] for p in self.parameters])
        error = np.array([sigmas[p.name] for p in self.parameters])
        total = float(np.linalg.norm(rate))
        least = total - SURE * float(np.linalg.norm(rate * error)) / max(total, 1e-300)
        return total / RATE if least > RATE else 1.0

    def too_small(self, values: FloatArray, covariance: FloatArray) -> bool:
        """Return whether a rotation, rad/s, is certainly slower than the Earth's anywhere."""
        total = float(np.linalg.norm(values))
        error = float(np.sqrt(values @ covariance @ values)) / max(total, 1e-300)
        widest = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        return total + SURE * max(error, widest) < SLOW * RATE

    def typical(self, *, span: tuple[float, float]) -> dict[str, float]:
        """Return the Earth's rotation at 45 degrees north."""
        return components(np.pi / 4)

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the axes of frame n in the sensor frame; nothing where orientation is not known.

        Where heading is known only up to a constant, east and north are rotated by it.
        """
        if state.mat_ns is None:
            return {}
        return {
            name: {f"gyro.{a}": state.mat_ns[:, row, i] for i, a in enumerate(AXES)}
            for row, name in enumerate(("east", "north", "up"))
        }


def components(latitude: float) -> dict[str, float]:
    """Return the parameters at a latitude (rad, north positive)."""
    return {
        "east": 0.0,
        "north": RATE * float(np.cos(latitude)),
        "up": RATE * float(np.sin(latitude)),
    }


EFFECT = EarthRate()
