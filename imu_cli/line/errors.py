"""Errors of the production line."""

from __future__ import annotations

from calib.errors import ImuError


class StationError(ImuError, ValueError):
    """A station file cannot be used; exits as wrong usage."""

    exit_code = 2


class HistoryError(ImuError):
    """The history cannot be opened or refuses what was asked; exits as a device does."""

    exit_code = 7
