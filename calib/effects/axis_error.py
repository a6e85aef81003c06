"""Axes swapped or with the wrong sign."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations, product

import numpy as np

from calib.effects.base import (
    FORM,
    PRESENCE,
    Column,
    Parameter,
    ShapeParameter,
    Signals,
    State,
    TransformEffect,
)
from calib.effects.resampling import each_triad, presence_columns
from calib.recording import AXES
from calib.types import FloatArray

ORDERS = tuple(
    (order, signs) for order in permutations(range(3)) for signs in product((1, -1), repeat=3)
)
"""The 48 ways to lay three axes onto three axes; number 0 changes nothing."""


class AxisError(TransformEffect):
    """``x_m = P x``, P one of the 48 signed permutations, by its number in `ORDERS`."""

    slug = "axis_error"
    title = "axis error"
    equation = "x_m = P x, P a signed permutation"
    source = "A wrong axis map: 47 ways to be wrong, half of them mirror images"
    kind = "setup"
    stage = "readout"
    parameters = (
        Parameter("accel", PRESENCE, 1.0, ("accel.x", "accel.y", "accel.z")),
        Parameter("gyro", PRESENCE, 1.0, ("gyro.x", "gyro.y", "gyro.z")),
    )
    shape = (
        ShapeParameter("accel_axes", FORM, 0, 47, "integer", optional=True),
        ShapeParameter("gyro_axes", FORM, 0, 47, "integer", optional=True),
    )
    follows = "the signals of other axes"
    needs = (
        "turns about each axis; the gyro is told from the accelerometer, but a mistake common to "
        "both that keeps the hand (a rotation) cannot be seen"
    )
    sentence = "Gravity and turns disagree: axes are swapped, or one has the wrong sign."
    absorbed_by = ("gyro.scale_factor_error", "gyro.misalignment")
    rivals = ("gyro_misalignment", "reference_misalignment")

    def columns(self, state: State, shape: Mapping[str, float]) -> dict[str, Column]:
        """Return the whole change of each triad whose order is given."""
        return presence_columns(state, shape, "axes", _lay)

    def transform(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return each_triad(signals, parameters, "axes", _lay)

    def inverse(
        self, time: FloatArray, signals: Signals, parameters: Mapping[str, float]
    ) -> Signals:
        return each_triad(
            signals, parameters, "axes", lambda x, number: x @ signed_permutation(int(number))
        )

    def in_words(self, shape: Mapping[str, float]) -> str:
        said = [
            f"The {triad}'s axes show {describe_order(int(shape[f'{triad}_axes']))}."
            for triad in ("accel", "gyro")
            if f"{triad}_axes" in shape
        ]
        return " ".join(said)


def signed_permutation(number: int) -> FloatArray:
    """Return the matrix (3, 3) of one of the `ORDERS`."""
    order, signs = ORDERS[number]
    matrix: FloatArray = np.eye(3)[list(order)] * np.array(signs)[:, None]
    return matrix


def describe_order(number: int) -> str:
    """Return what each axis shows: ``x: -y, y: x, z: z``."""
    order, signs = ORDERS[number]
    return ", ".join(
        f"{a}: {'-' if sign < 0 else ''}{AXES[i]}"
        for a, i, sign in zip(AXES, order, signs, strict=True)
    )


def _lay(values: FloatArray, number: float) -> FloatArray:
    return values @ signed_permutation(int(number)).T


EFFECT = AxisError()
