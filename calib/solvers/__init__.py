"""Solvers, one file each, with an ``ACCEL_SOLVER`` or a ``GYRO_SOLVER``."""

from __future__ import annotations

from functools import cache

from calib.registry import discover
from calib.solvers.base import AccelSolver, GyroSolver


@cache
def accel_solvers() -> dict[str, AccelSolver]:
    """Return every accelerometer method by its name."""
    return discover(__name__, __path__, attribute="ACCEL_SOLVER", kind=AccelSolver, key="name")


@cache
def gyro_solvers() -> dict[str, GyroSolver]:
    """Return every gyroscope method by its name."""
    return discover(__name__, __path__, attribute="GYRO_SOLVER", kind=GyroSolver, key="name")
