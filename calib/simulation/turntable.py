"""A rate table or record player, with the sensor off its centre."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.rotation import mat_from_quat, rotvec_from_mat
from calib.simulation.kinematics import Angle, Kinematics, Motion, Path, Segment, at_rest
from calib.simulation.motions import FACES, UPRIGHT, X, Z
from calib.simulation.profiles import MINIMUM_JERK
from calib.types import FloatArray

RECORD_PLAYER = (2 * np.pi * 100 / 3 / 60,)
"""33 1/3 revolutions a minute, rad/s: 200 degrees per second."""


def turntable(
    rates: Sequence[float] = RECORD_PLAYER,
    *,
    faces: Sequence[str] = ("+z",),
    offset: tuple[float, float, float] = (0.08, 0.0, 0.02),
    spin: float = 10.0,
    rest: float = 5.0,
    ramp: float = 2.0,
    remount: float = 3.0,
    tilt: float = 0.0,
    gravity: float = 9.80665,
) -> Motion:
    """Return rests and steady spins about the vertical; on each face in turn, at each rate.

    Parameters
    ----------
    rates : sequence of float, rad/s
        Signed, right-handed about up. Each is reached from rest in `ramp` seconds, held for `spin`
        seconds, and left the same way; between them the table rests.
    faces : sequence of {"+x", "-x", "+y", "-y", "+z", "-z"}
        The sensor axis that points up. Between faces the sensor is turned by hand.
    offset : (3,) m
        From the table's axis to the sensor, in the table's frame.
    spin, rest, ramp, remount : float, s
    tilt : float, rad
        Of the table's axis from the vertical, about frame n's x axis.

    Raises
    ------
    ValueError
        If a face is unknown, or a duration is not positive.
    """
    for name, value in (("spin", spin), ("rest", rest), ("ramp", ramp), ("remount", remount)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"`{name}` must be positive and finite, got {value}")
    unknown = [face for face in faces if face not in FACES]
    if unknown or not faces:
        raise ValueError(f"`faces` must be of {', '.join(FACES)}, got {', '.join(unknown) or '()'}")
    pieces, segments, hands = _script(
        rates, faces, spin=spin, rest=rest, ramp=ramp, remount=remount
    )
    start, length, before, after = (np.array(column) for column in zip(*pieces, strict=True))
    # The table's angle at the start of each piece: its mean rate times its duration.
    angle = np.concatenate([[0.0], np.cumsum(length * (before + after) / 2)[:-1]])
    arm, duration = np.array(offset), float(start[-1] + length[-1])
    antiderivative = MINIMUM_JERK.integ()
    slope = MINIMUM_JERK.deriv()
    swings = _mounts(faces, hands)

    def kinematics(time: FloatArray) -> Kinematics:
        k = np.clip(np.searchsorted(start, time, side="right") - 1, 0, len(start) - 1)
        u = np.clip((time - start[k]) / length[k], 0.0, 1.0)
        step = after[k] - before[k]
        table = Angle(
            angle[k] + length[k] * (before[k] * u + step * antiderivative(u)),
            before[k] + step * MINIMUM_JERK(u),
            step * slope(u) / length[k],
        )
        level = at_rest(np.tile(UPRIGHT, (len(time), 1)))
        leaning = level.then(
            X, Angle(*np.stack([np.full(len(time), tilt), *np.zeros((2, len(time)))]))
        )
        turning = leaning.then(Z, table)
        path = _circle(turning.quat, arm, table)
        for axis, size, begin in swings:
            u = np.clip((time - begin) / remount, 0.0, 1.0)
            values = (MINIMUM_JERK(u), slope(u) / remount, slope.deriv()(u) / remount**2)
            turning = turning.then(axis, Angle(*(size * value for value in values)))
        return Kinematics(turning, path)

    return Motion("turntable", duration, kinematics, tuple(segments), gravity=gravity)


def _circle(quat: FloatArray, arm: FloatArray, table: Angle) -> Path:
    """Return the path of a point that is fixed on the table; `quat` is the table's orientation."""
    mat_nt = mat_from_quat(quat)
    along, inward = np.cross(Z, arm), np.cross(Z, np.cross(Z, arm))
    rate, acceleration = table.rate[:, None], table.acceleration[:, None]
    in_table = acceleration * along + rate**2 * inward
    return Path(
        mat_nt @ arm,
        np.einsum("nij,nj->ni", mat_nt, rate * along),
        np.einsum("nij,nj->ni", mat_nt, in_table),
    )


Piece = tuple[float, float, float, float]


def _script(
    rates: Sequence[float],
    faces: Sequence[str],
    *,
    spin: float,
    rest: float,
    ramp: float,
    remount: float,
) -> tuple[list[Piece], list[Segment], list[float]]:
    """Return (start, duration, rate before, rate after) pieces, labels, and when hands turn it."""
    pieces: list[Piece] = []
    segments: list[Segment] = []
    hands: list[float] = []
    now = 0.0

    def add(kind: str, length: float, first: float, last: float, label: str) -> None:
        nonlocal now
        pieces.append((now, length, first, last))
        if kind:
            segments.append(Segment(kind, now, now + length, label))  # type: ignore[arg-type]
        now += length

    for number, face in enumerate(faces):
        if number:
            hands.append(now)
            add("turn", remount, 0.0, 0.0, f"remount on {face}")
        for rate in rates:
            add("static", rest, 0.0, 0.0, f"{face} at rest")
            add("", ramp, 0.0, rate, "")
            add("spin", spin, rate, rate, f"{face} at {np.degrees(rate):.6g} dps")
            add("", ramp, rate, 0.0, "")
        add("static", rest, 0.0, 0.0, f"{face} at rest")
    return pieces, segments, hands


def _mounts(faces: Sequence[str], hands: Sequence[float]) -> list[tuple[FloatArray, float, float]]:
    """Return each turn in the sensor's frame: axis, angle and start; the first is done at once."""
    out = []
    last = np.eye(3)
    for face, begin in zip(faces, (-np.inf, *hands), strict=True):
        mat = mat_from_quat(FACES[face])
        axis, angle = _axis_angle(last.T @ mat)
        out.append((axis, angle, begin))
        last = mat
    return out


def _axis_angle(mat: FloatArray) -> tuple[FloatArray, float]:
    rotvec = rotvec_from_mat(mat)
    angle = float(np.linalg.norm(rotvec))
    return (rotvec / angle if angle else np.eye(3)[0]), angle
