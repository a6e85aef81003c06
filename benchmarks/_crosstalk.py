"""What a channel hears of the motion about or along other axes: seventeen kinds, none has a name.

Each is a function of the true state on one channel, throughout. Axis k is the channel's own, j and
m are the others, in an order that is drawn, as the channel is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from _outside import Case, Disturbance, whole

from calib.effects.base import State
from calib.mismatch.rows.rows import Rows

Heard = Callable[[State, int, int, int], np.ndarray]


def _speed(state: State) -> np.ndarray:
    return np.asarray(np.linalg.norm(state.rate, axis=1))


KINDS: dict[str, Heard] = {
    "accel_prod": lambda s, k, j, m: s.rate[:, j] * s.rate[:, m],
    "accel_sq": lambda s, k, j, m: np.square(s.rate).sum(axis=1),
    "accel_own_sq": lambda s, k, j, m: np.square(s.rate[:, k]),
    "accel_dot": lambda s, k, j, m: s.rate_dot[:, k],
    "accel_fdot": lambda s, k, j, m: s.force_dot[:, j],
    "accel_tanh": lambda s, k, j, m: np.tanh(2 * s.rate[:, j]),
    "accel_force_abs": lambda s, k, j, m: np.abs(s.force[:, j]),
    "accel_gain_speed": lambda s, k, j, m: s.force[:, k] * _speed(s),
    "accel_rate_lin": lambda s, k, j, m: s.rate[:, j],
    "gyro_dot": lambda s, k, j, m: s.rate_dot[:, j],
    "gyro_fdot": lambda s, k, j, m: s.force_dot[:, j],
    "gyro_speed": lambda s, k, j, m: _speed(s),
    "gyro_sqrt": lambda s, k, j, m: np.sqrt(np.abs(s.rate[:, j])),
    "gyro_force_abs": lambda s, k, j, m: np.abs(s.force[:, j]),
    "gyro_cubed": lambda s, k, j, m: s.rate[:, j] ** 3,
    "gyro_two": lambda s, k, j, m: s.rate[:, k] * np.abs(s.rate[:, j]),
    "gyro_f_speed": lambda s, k, j, m: s.force[:, j] * _speed(s),
}


def _made(name: str, heard: Heard) -> Callable[[Rows, np.random.Generator], Case]:
    def case(rows: Rows, rng: np.random.Generator) -> Case:
        k = int(rng.integers(3))
        j = (k + 1 + int(rng.integers(2))) % 3
        channel = f"{name.partition('_')[0]}.{'xyz'[k]}"
        add: Disturbance = lambda state: {channel: heard(state, k, j, 3 - k - j)}  # noqa: E731
        return Case(add, whole(rows), lambda _: add)

    return case


CROSSTALK = {name: _made(name, heard) for name, heard in KINDS.items()}
