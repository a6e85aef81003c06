"""What accuracy a session aims for, by group of parameters or by parameter."""

from __future__ import annotations

from collections.abc import Iterable

from calib.calibration import parameter_unit
from calib.planning import NAMES
from imu_cli.line.quantity import parse_quantity

DEFAULTS = {
    "accel.bias": "1.5 mg",
    "accel.scale_factor_error": "0.15 %",
    "accel.misalignment": "0.1 deg",
    "gyro.bias": "0.02 dps",
    "gyro.scale_factor_error": "0.15 %",
    "gyro.misalignment": "0.1 deg",
}
"""Standard errors that a consumer part repeats to from one power-on to the next."""


def make_targets(wanted: Iterable[str]) -> dict[str, float]:
    """Return a target in SI for each planned parameter.

    Parameters
    ----------
    wanted : iterable of str
        ``GROUP=QUANTITY`` or ``PARAMETER=QUANTITY``, such as ``accel.bias="1 mg"``; the more exact
        name wins.

    Raises
    ------
    ValueError
        If a name or quantity is not understood; the message names it.
    """
    texts = dict(DEFAULTS)
    for item in wanted:
        name, sign, quantity = item.partition("=")
        if not sign or not any(name in (p, p.rpartition(".")[0]) for p in NAMES):
            groups = ", ".join(DEFAULTS)
            raise ValueError(f"{item!r} is no target: write GROUP=QUANTITY, with one of {groups}")
        texts[name] = quantity
    targets = {}
    for name in NAMES:
        text = texts.get(name, texts[name.rpartition(".")[0]])
        targets[name] = parse_quantity(text, unit=parameter_unit(name))
        if targets[name] <= 0:
            raise ValueError(f"the target of {name} must be positive, got {text!r}")
    return targets
