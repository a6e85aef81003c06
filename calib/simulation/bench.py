"""The bench protocol: an IMU is laid down in many poses and turned by hand between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulation.kinematics import Angle, Kinematics, Motion, Path, Segment, Turning, at_rest
from calib.simulation.profiles import (
    HUMP,
    MINIMUM_JERK,
    combine,
    evaluate,
    random_sinusoids,
    scaled,
    summed,
)
from calib.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class _Script:
    """m turns and the m + 1 poses around them; turn i goes from pose i to pose i + 1."""

    start: FloatArray  # (m,) s
    duration: FloatArray  # (m,) s
    axes: FloatArray  # (m, 2, 3) unit; the second turns inside the first
    angles: FloatArray  # (m, 2) rad
    haste: FloatArray  # (m,) how far from symmetric the turn's speed is
    quat: FloatArray  # (m + 1, 4) orientation of each pose
    place: FloatArray  # (m + 1, 3) m
    lift: FloatArray  # (m, 3) m, on the way


@dataclass(frozen=True, eq=False)
class _Hand:
    """How a hand moves what it holds: how much, and six functions of time, angles then places."""

    strength: Callable[[IntArray, FloatArray], Angle]
    motion: list[Callable[[FloatArray], Angle]]


def bench_protocol(
    rng: np.random.Generator,
    *,
    poses: int = 30,
    pose_duration: tuple[float, float] = (3.0, 6.0),
    turn_duration: tuple[float, float] = (0.8, 2.5),
    first_pose: float = 10.0,
    mixed: float = 0.4,
    travel: float = 0.15,
    tremor: float = 1.0,
    hold_tremor: float = 0.0,
    sway: float = 0.0,
    swayed: float = 1.0,
    temperature: float | None = 28.0,
    warm_up: float = 6.0,
    warm_up_time: float = 180.0,
    power_on: float = 0.0,
    vibration: float = 0.0,
    vibrated: float = 0.3,
    gravity: float = 9.80665,
) -> Motion:
    """Return static poses with hand turns between them.

    Parameters
    ----------
    poses : int
    pose_duration, turn_duration : (low, high), s
        Each pose and each turn takes a time between these.
    first_pose : float, s
        Added to the first pose: the still start of a recording.
    mixed : float
        Share of turns about two arbitrary axes at once. The others go about one sensor axis by
        near a quarter or half turn, each axis both ways in its turn.
    travel : float, m
        Size of the area in which poses are laid down; between them the hand lifts the sensor.
    tremor : float
        Shaking of the hand while it turns the sensor, in multiples of 0.3° and 0.2 mm rms at
        4-11 Hz, which is physiological hand tremor.
    hold_tremor : float
        The same while it is held still, for hand-held pauses; 0 is laid down.
    sway : float
        Slow wandering of a hand that holds still, in multiples of 0.2° and 2 mm rms at 0.1-0.7 Hz,
        in a share `swayed` of the poses, and in the turns beside them.
    temperature : float or None, °C
        Of the start; it rises by `warm_up` (K) with time constant `warm_up_time` (s) from
        `power_on` (s, 0 or before).
    vibration : float, m/s²
        Standard deviation of the specific force on each axis while the bench is shaken (by a motor,
        faster than the sensor samples), in a share `vibrated` of the poses.

    Raises
    ------
    ValueError
        If there is no pose, or a duration is not positive.
    """
    if poses < 1:
        raise ValueError(f"`poses` must be at least 1, got {poses}")
    for name, (low, high) in (("pose_duration", pose_duration), ("turn_duration", turn_duration)):
        if not 0 < low <= high:
            raise ValueError(f"`{name}` must be (low, high) with 0 < low <= high, got {low, high}")
    rest = rng.uniform(*pose_duration, poses)
    rest[0] += first_pose
    turn = rng.uniform(*turn_duration, poses - 1)
    stop = np.cumsum(rest) + np.concatenate([[0.0], np.cumsum(turn)])
    script = _random_script(rng, stop[:-1], turn, mixed=mixed, travel=travel)
    hands = [
        _Hand(
            _envelope(script, tremor=tremor, hold=hold_tremor),
            [random_sinusoids(rng, rms=np.radians(0.3), low=4, high=11) for _ in range(3)]
            + [random_sinusoids(rng, rms=0.2e-3, low=4, high=11) for _ in range(3)],
        )
    ]
    shaken = np.flatnonzero(rng.random(poses) < vibrated) if vibration else np.zeros(0, np.int64)
    begin, end = (stop - rest)[shaken], stop[shaken]
    if sway:
        strength = _fading(script, np.where(rng.random(poses) < swayed, sway, 0.0))
        slow = [random_sinusoids(rng, rms=np.radians(0.2), low=0.1, high=0.7) for _ in range(3)]
        slow += [random_sinusoids(rng, rms=2e-3, low=0.1, high=0.7) for _ in range(3)]
        hands.append(_Hand(strength, slow))
    segments = []
    for i in range(poses):
        segments.append(Segment("static", stop[i] - rest[i], stop[i], f"pose {i + 1}"))
        if i < poses - 1:
            kind = "mixed" if script.angles[i, 1] else "xyz"[int(np.argmax(abs(script.axes[i, 0])))]
            segments.append(Segment("turn", stop[i], stop[i] + turn[i], f"turn {i + 1}, {kind}"))
    return Motion(
        "bench",
        float(stop[-1]),
        lambda time: _kinematics(script, hands, time),
        tuple(segments),
        temperature=None
        if temperature is None
        else lambda time: temperature + warm_up * (1 - np.exp((power_on - time) / warm_up_time)),
        vibration=_vibration(begin, end, vibration) if vibration else None,
        power_on=power_on,
        gravity=gravity,
    )


def _vibration(
    begin: FloatArray, end: FloatArray, size: float
) -> Callable[[FloatArray], FloatArray]:
    def at(time: FloatArray) -> FloatArray:
        inside = np.searchsorted(begin, time, side="right") > np.searchsorted(end, time)
        return np.repeat(np.where(inside, size, 0.0)[:, None], 3, axis=1)

    return at


def _random_script(
    rng: np.random.Generator,
    start: FloatArray,
    duration: FloatArray,
    *,
    mixed: float,
    travel: float,
) -> _Script:
    m = len(start)
    axes, angles = np.zeros((m, 2, 3)), np.zeros((m, 2))
    axes[:, 1, 0] = 1.0
    order = np.concatenate([rng.permutation(6) for _ in range(m // 6 + 1)])[:m]
    for i in range(m):
        if rng.random() < mixed:
            axes[i] = rng.normal(size=(2, 3))
            axes[i] /= np.linalg.norm(axes[i], axis=1, keepdims=True)
            angles[i] = rng.uniform(np.radians(30), np.radians(120), 2)
        else:
            # One sensor axis, as nearly as a hand does it.
            axes[i, 0] = np.eye(3)[order[i] // 2] + rng.normal(0, 0.03, 3)
            axes[i, 0] /= np.linalg.norm(axes[i, 0])
            quarter = rng.choice([np.pi / 2, np.pi / 2, np.pi]) + rng.normal(0, np.radians(3))
            angles[i, 0] = quarter if order[i] % 2 else -quarter
    quat = np.empty((m + 1, 4))
    first = rng.normal(0, np.radians(2), 3)
    first[2] = rng.uniform(-np.pi, np.pi)
    quat[0] = quat_from_rotvec(first)
    for i in range(m):
        turned = quat_multiply(quat[i], quat_from_rotvec(axes[i, 0] * angles[i, 0]))
        quat[i + 1] = quat_multiply(turned, quat_from_rotvec(axes[i, 1] * angles[i, 1]))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    place = rng.uniform(-travel, travel, (m + 1, 3)) * [1.0, 1.0, 0.2]
    lift = rng.normal(0, 0.2 * travel, (m, 3))
    lift[:, 2] = travel * rng.uniform(0.2, 0.8, m)
    return _Script(start, duration, axes, angles, rng.uniform(-0.08, 0.08, m), quat, place, lift)


def _phase(script: _Script, time: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the index of the turn that is next or under way, and how far it is (0 to 1)."""
    turn = np.searchsorted(script.start + script.duration, time, side="right")
    turn = np.minimum(turn, len(script.start) - 1).astype(np.int64)
    return turn, np.clip((time - script.start[turn]) / script.duration[turn], 0.0, 1.0)


def _envelope(
    script: _Script, *, tremor: float, hold: float
) -> Callable[[IntArray, FloatArray], Angle]:
    def at(turn: IntArray, u: FloatArray) -> Angle:
        hump = scaled(evaluate(HUMP, u, script.duration[turn]), tremor)
        return Angle(hump.value + hold, hump.rate, hump.acceleration)

    return at


def _fading(script: _Script, strength: FloatArray) -> Callable[[IntArray, FloatArray], Angle]:
    """Return the strength of each pose, and between them a smooth way from one to the next."""

    def at(turn: IntArray, u: FloatArray) -> Angle:
        step = evaluate(MINIMUM_JERK, u, script.duration[turn])
        fade = scaled(step, (strength[1:] - strength[:-1])[turn])
        return Angle(strength[turn] + fade.value, fade.rate, fade.acceleration)

    return at


def _kinematics(
    script: _Script,
    hands: list[_Hand],
    time: FloatArray,
) -> Kinematics:
    n = len(time)
    if not len(script.start):
        return Kinematics(at_rest(np.tile(script.quat[0], (n, 1))))
    turn, u = _phase(script, time)
    duration = script.duration[turn]
    step, hump = evaluate(MINIMUM_JERK, u, duration), evaluate(HUMP, u, duration)
    profile = summed(step, scaled(hump, script.haste[turn]))
    turning = at_rest(script.quat[turn])
    for k in range(2):
        turning = turning.then(script.axes[turn, k], scaled(profile, script.angles[turn, k]))
    way = (script.place[1:] - script.place[:-1])[turn]
    lift = script.lift[turn]
    moves = [
        step_part[:, None] * way + hump_part[:, None] * lift
        for step_part, hump_part in zip(step, hump, strict=True)
    ]
    moves[0] += script.place[turn]
    for hand in hands:
        # Only where its strength is not zero: most of a recording is at rest.
        strength = hand.strength(turn, u)
        some = np.flatnonzero((strength.value != 0) | (strength.acceleration != 0))
        if not len(some):
            continue
        part = Angle(*(value[some] for value in strength))
        moved = Turning(*(value[some] for value in turning))
        for axis in range(3):
            moved = moved.then(np.eye(3)[axis], combine(part, hand.motion[axis](time[some])))
            place = combine(part, hand.motion[3 + axis](time[some]))
            for move, value in zip(moves, place, strict=True):
                move[some, axis] += value
        turning = Turning(*(value.copy() for value in turning))
        for whole, value in zip(turning, moved, strict=True):
            whole[some] = value
    return Kinematics(turning, Path(*moves))
