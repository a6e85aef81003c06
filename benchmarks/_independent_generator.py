"""Recordings for `independent.py`: motion, sensor and effects from first principles, numpy only.

Nothing here comes from the project that it judges: attitude is a chain of quaternions on a grid of
1 to 1.6 kHz, rates are their logarithms, specific force is the second difference of the position of
a sensor that a hand carries, and each effect is written from its equation.

Frames and signs: n is east-north-up, ``mat_ns`` takes sensor vectors to n, specific force at rest
points up, and ``d(mat_ns)/dt = mat_ns [w]x``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

AXES = "xyz"
G0 = 9.80665
DPS = np.pi / 180
EARTH = 7.292115e-5


@dataclass(frozen=True)
class Part:
    """Noise and resolution of a part; densities are one-sided, walks per root second."""

    name: str
    density: tuple[float, float]  # m/s²/√Hz, rad/s/√Hz
    instability: tuple[float, float]
    walk: tuple[float, float]
    lsb: tuple[float, float]


MG, DPH = 1e-3 * G0, DPS / 3600
PARTS = (
    Part("mpu6050", (0.4 * MG, 0.005 * DPS), (0.06 * MG, 7 * DPH), (1e-5, 1e-6),
         (G0 / 16384, DPS / 65.5)),
    Part("icm", (0.2 * MG, 0.006 * DPS), (0.04 * MG, 5 * DPH), (6e-6, 7e-7),
         (G0 / 8192, DPS / 65.5)),
    Part("bmi", (0.15 * MG, 0.007 * DPS), (0.03 * MG, 4 * DPH), (5e-6, 6e-7),
         (G0 / 8192, DPS / 32.8)),
    Part("tactical", (0.03 * MG, 0.0015 * DPS), (0.01 * MG, 0.8 * DPH), (1e-6, 1e-7),
         (G0 / 1e6, DPS / 5e4)),
)  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """What a recording is apart from what is concealed in it."""

    part: Part
    rate: float
    poses: int
    pose_style: str  # random, faces, steps
    rests: tuple[float, float]
    profiles: tuple[str, ...]
    temperature: str  # none, room, warm_up, ramp, cycle
    misaligned: bool
    start: float = 0.0
    gravity: float = G0
    averaged: bool = False
    earth: bool = False
    tremor: float = 1.0
    drift: float = 1.0
    wobble: float = 0.0  # rad, of a hand that holds the poses
    knock: bool = False
    shaken: bool = False
    late: float = 0.0  # s, by which stamps scatter that a host makes; the samples are even
    exact: bool = False
    """Printed to 9 digits without rounding to counts."""


def draw_setting(rng: np.random.Generator, **forced: object) -> Setting:
    """Return a random setting; `forced` fields are as given. It lasts 3 to 15 minutes."""
    low, high = ((2, 5), (3, 8), (2, 30), (5, 15), (8, 12))[rng.integers(5)]
    total = rng.uniform(240, 800)
    poses = int(np.clip(total / (0.5 * (low + high) + 2.0), 20, 60))
    setting = Setting(
        part=PARTS[int(rng.choice(len(PARTS), p=[0.35, 0.25, 0.25, 0.15]))],
        rate=float(rng.choice([50.0, 100.0, 100.0, 200.0, 400.0])),
        poses=poses,
        pose_style=str(rng.choice(["random", "random", "faces", "steps"])),
        rests=(low, high),
        profiles=tuple(rng.choice(list(PROFILES), size=2, replace=False)),
        temperature=str(rng.choice(["none", "room", "warm_up", "ramp", "cycle"])),
        misaligned=bool(rng.random() < 0.4),
        start=float(rng.choice([0.0, 0.0, 12.34, 5000.0, 1.7e9])),
        gravity=float(rng.choice([G0, rng.uniform(9.782, 9.830)])),
        averaged=bool(rng.random() < 0.3),
        earth=bool(rng.random() < 0.3),
        tremor=float(rng.uniform(0.2, 1.5)),
        exact=bool(rng.random() < 0.3),
    )
    return replace(setting, **forced)  # type: ignore[arg-type]


# Rotations -----------------------------------------------------------------------------------


def multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the quaternion product, scalar first, of arrays (..., 4)."""
    a, b, c, d = np.moveaxis(p, -1, 0)
    e, f, g, h = np.moveaxis(q, -1, 0)
    return np.stack(
        (a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g,
         a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e), -1,
    )  # fmt: skip


def exponential(v: np.ndarray) -> np.ndarray:
    """Return the quaternion of the rotation vector."""
    half = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate((np.cos(half), 0.5 * v * np.sinc(half / np.pi)), -1)


def logarithm(q: np.ndarray) -> np.ndarray:
    """Return the rotation vector, at most pi long."""
    q = np.where(q[..., :1] < 0, -q, q)
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, q[..., :1])
    return q[..., 1:] * np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 2.0)


def matrix(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
         2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
         2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), -1,
    ).reshape(*q.shape[:-1], 3, 3)  # fmt: skip


def pose_chain(rng: np.random.Generator, setting: Setting) -> np.ndarray:
    """Return quaternions (poses, 4) of the rests."""
    n = setting.poses
    if setting.pose_style == "steps":
        out = [exponential(rng.normal(0, 0.1, 3))]
        while len(out) < n:
            axis = np.eye(3)[rng.integers(3)] + rng.normal(0, 0.05, 3)
            angle = rng.choice([-1, 1]) * rng.uniform(50, 150) * DPS
            out.append(multiply(out[-1], exponential(axis * angle)))
        return np.array(out)
    if setting.pose_style == "faces":
        grid = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
        size = np.abs(grid).sum(axis=1)
        faces, edges = grid[size == 1], grid[size > 1]
        ups = np.vstack((rng.permutation(faces), rng.permutation(edges), rng.permutation(faces)))
        ups = np.vstack((ups, rng.permutation(grid[size > 0])))[:n].astype(float)
        ups = np.vstack((ups, rng.normal(size=(n - len(ups), 3)))) if len(ups) < n else ups
        ups += rng.normal(0, 0.03, ups.shape)
    else:
        ups = rng.normal(size=(n, 3))
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    out = []
    for up in ups:
        # Shortest way that takes `up` (sensor frame) to z (frame n), then any heading.
        axis = np.cross(up, [0, 0, 1.0])
        angle = np.arctan2(np.linalg.norm(axis), up[2])
        axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else np.array([1.0, 0, 0])
        heading = np.array([0, 0, rng.uniform(-np.pi, np.pi)])
        out.append(multiply(exponential(heading), exponential(axis * angle)))
    return np.array(out)


def _jerk(u: np.ndarray) -> np.ndarray:
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u * u)


def _trapezoid(u: np.ndarray, ramp: float) -> np.ndarray:
    """Return the share of the turn made by `u`: constant rate between raised-cosine ramps."""
    u = np.clip(u, 0, 1)
    top = 1 / (1 - ramp)

    def rising(x: np.ndarray) -> np.ndarray:
        return 0.5 * top * (x - ramp / np.pi * np.sin(np.pi * x / ramp))

    middle = 0.5 * top * ramp + top * (u - ramp)
    return np.where(u < ramp, rising(u), np.where(u > 1 - ramp, 1 - rising(1 - u), middle))


PROFILES: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "jerk": lambda u, rng: _jerk(u),
    "trapezoid": lambda u, rng: _trapezoid(u, rng.uniform(0.15, 0.4)),
    "overshoot": lambda u, rng: _jerk(u) + rng.uniform(30, 100) * u**8 * (1 - u) ** 3,
    "skewed": lambda u, rng: _jerk(u ** rng.uniform(0.75, 1.5)),
    "paused": lambda u, rng: 0.5 * (_jerk(u / 0.45) + _jerk((u - 0.55) / 0.45)),
}
"""Share of a turn made after a share of its time: minimum jerk and what hands make of it."""


# Motion --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Motion:
    """The truth on a fine, even grid: (n, 3) force and rate, and what effects are functions of."""

    time: np.ndarray
    step: float
    stride: int
    force: np.ndarray
    rate: np.ndarray
    quaternion: np.ndarray
    position: np.ndarray
    temperature: np.ndarray
    since_turn: np.ndarray
    vibration: np.ndarray
    """Variance of the vibration, (n, 3)."""
    rests: np.ndarray
    """(poses, 2), s."""
    setting: Setting
    earth_up: float
    """The Earth's rate about the vertical, rad/s."""

    def pick(self, values: np.ndarray) -> np.ndarray:
        """Return the samples of a fine signal: its value, or its mean over the sample interval."""
        k = self.stride
        if self.setting.averaged:
            return values[: len(values) // k * k].reshape(-1, k, *values.shape[1:]).mean(axis=1)
        return values[k // 2 :: k][: len(values) // k]


def make_motion(rng: np.random.Generator, setting: Setting) -> Motion:
    """Return the motion of poses that a hand turns a sensor between."""
    quaternions = pose_chain(rng, setting)
    n = setting.poses
    rest_times = rng.uniform(*setting.rests, n)
    rest_times[0] = max(rest_times[0], 5.0)
    relative = logarithm(multiply(quaternions[:-1] * [1, -1, -1, -1], quaternions[1:]))
    angles = np.linalg.norm(relative, axis=1)
    turn_times = np.maximum(0.5, angles / (rng.uniform(50, 150, n - 1) * DPS))
    stride = round((1000 if setting.rate == 50 else 1600) / setting.rate)
    stride += stride % 2
    step = 1 / setting.rate / stride
    ends = np.cumsum(np.insert(rest_times[1:] + turn_times, 0, rest_times[0]))
    rests = np.stack((ends - rest_times, ends), axis=1)
    rests = np.round(rests / (step * stride)) * (step * stride)
    node = np.arange(round(rests[-1, 1] / step) + 1) * step
    q = np.empty((len(node), 4))
    hand, small, shift = (np.zeros((len(node), 3)) for _ in range(3))
    at = np.zeros(3)
    index = np.round(rests / step).astype(int)
    q[: index[0, 1] + 1] = quaternions[0]
    for i in range(n - 1):
        a, b = index[i, 1], index[i + 1, 0]
        u = np.linspace(0, 1, b - a + 1)[:, None]
        first = np.zeros(3)
        if setting.pose_style != "steps" and rng.random() < 0.8:
            first = rng.normal(0, 0.5, 3)  # two rotations that overlap: no fixed axis
        second = logarithm(multiply(exponential(-first), exponential(relative[i])))
        profile = [PROFILES[str(rng.choice(setting.profiles))] for _ in range(2)]
        lag = rng.uniform(0.7, 1.0, 2)
        one = profile[0](np.minimum(u / lag[0], 1), rng)
        two = profile[1](np.maximum(1 - (1 - u) / lag[1], 0), rng)
        start = quaternions[i]
        q[a : b + 1] = multiply(
            multiply(start, exponential(first * one)), exponential(second * two)
        )
        # The profile ends at 1, so this is the next pose; said exactly against rounding.
        q[b : index[i + 1, 1] + 1] = q[b]
        quaternions[i + 1] = q[b]
        move = rng.normal(0, 0.08, 3) * [1, 1, 0]
        lift = rng.uniform(0.0, 0.15) * 64 * (u * (1 - u)) ** 3
        hand[a : b + 1] = at + move * _jerk(u) + lift * [0, 0, 1]
        at = at + move
        hand[b : index[i + 1, 1] + 1] = at
        envelope = np.sin(np.pi * u) ** 2
        t = node[a : b + 1, None]
        for target, size in ((small, 8e-4), (shift, 2e-4)):
            for _ in range(2):
                phase = rng.uniform(0, 2 * np.pi, 3)
                wave = np.sin(2 * np.pi * rng.uniform(7, 12) * t + phase)
                target[a : b + 1] += setting.tremor * size * rng.normal(size=3) * envelope * wave
    if setting.wobble:
        small += setting.wobble * _band(rng, len(node), step, (0.5, 8.0))
    if setting.knock:
        i = int(rng.integers(n // 4, 3 * n // 4))
        since = np.clip(node - rests[i].mean(), 0, None)[:, None]
        ring = np.exp(-since / 0.08) * np.sin(2 * np.pi * 18 * since) * (1 - np.exp(-since / 0.01))
        shift += 2e-4 * rng.normal(size=3) * ring
        held = np.clip((rests[i, 1] - node[:, None]) / 0.3 + 1, 0, 1)  # goes with the next turn
        small += 4e-3 * rng.normal(size=3) * _jerk(since / 0.1) * _jerk(held)
    q = multiply(q, exponential(small))
    mat = matrix(q)
    lever = rng.normal(0, 0.06, 3)
    position = hand + shift + np.einsum("nij,j->ni", mat, lever)
    acceleration = np.zeros_like(position)
    acceleration[1:-1] = np.diff(position, 2, axis=0) / step**2
    acceleration[:, 2] += setting.gravity
    force = np.einsum("nji,nj->ni", mat, acceleration)
    force = 0.5 * (force[1:] + force[:-1])
    rate = logarithm(multiply(q[:-1] * [1, -1, -1, -1], q[1:])) / step
    middle = multiply(q[:-1], exponential(0.5 * step * rate))
    time = node[:-1] + 0.5 * step
    latitude = rng.uniform(20, 65) * DPS
    if setting.earth:
        earth = EARTH * np.array([0, np.cos(latitude), np.sin(latitude)])
        rate = rate + np.einsum("nji,j->ni", matrix(middle), earth)
    last = np.searchsorted(rests[1:, 0], time, side="right")
    since_turn = np.where(last > 0, time - np.insert(rests[1:, 0], 0, 0.0)[last], np.inf)
    vibration = np.zeros_like(force)
    if setting.shaken:
        # A machine beside it runs, at one of three speeds or not at all, from pose to pose.
        level = rng.choice([0.0, 0.0, 0.15, 0.3, 0.5], n) * rng.uniform(0.7, 1.2)
        direction = rng.uniform(0.5, 1.0, 3)
        on = np.interp(time, rests.ravel(), np.repeat(level, 2))
        vibration = np.square(on[:, None] * direction)
        force = force + np.sqrt(vibration) * rng.normal(size=force.shape)
    return Motion(
        time, step, stride, force, rate, middle, 0.5 * (position[1:] + position[:-1]),
        _temperature(rng, setting, time), since_turn,
        vibration, rests, setting, EARTH * np.sin(latitude),
    )  # fmt: skip


def _band(
    rng: np.random.Generator, count: int, step: float, band: tuple[float, float]
) -> np.ndarray:
    """Return noise of one unit rms in a band, (count, 3), its amplitude falling as 1/f."""
    size = 1 << int(np.ceil(np.log2(count)))
    f = np.fft.rfftfreq(size, step)[:, None]
    gain = np.where((f > band[0]) & (f < band[1]), 1 / np.maximum(f, band[0]), 0.0)
    values = np.fft.irfft(np.fft.rfft(rng.normal(size=(size, 3)), axis=0) * gain, size, axis=0)
    return values[:count] / values.std()


def _temperature(rng: np.random.Generator, setting: Setting, time: np.ndarray) -> np.ndarray:
    end = time[-1]
    base = rng.uniform(18, 32)
    wander = 0.1 * np.sin(2 * np.pi * time / rng.uniform(0.5, 2) / end + rng.uniform(0, 6))
    if setting.temperature == "warm_up":
        return base + wander + rng.uniform(5, 14) * (1 - np.exp(-time / rng.uniform(60, 240)))
    if setting.temperature == "ramp":
        return base + wander + rng.choice([-1, 1]) * rng.uniform(6, 15) * time / end
    if setting.temperature == "cycle":
        turns, phase = rng.uniform(1.2, 2.5), rng.uniform(0, 6)
        wave = np.sin(2 * np.pi * turns * time / end + phase)
        if rng.random() < 0.5:
            wave = 2 / np.pi * np.arcsin(wave)  # triangles
        return base + wander + rng.uniform(4, 10) * wave
    return base + wander


# Effects: columns that are linear in their parameters ------------------------------------------

Columns = dict[str, tuple[int, np.ndarray]]
"""What one unit of a parameter adds, as (channel, values on the fine grid)."""


@dataclass(frozen=True)
class Physics:
    """One effect: its typical sizes, its shapes, and how it changes the fine signals."""

    typical: dict[str, float]
    columns: Callable[[Motion, dict[str, float]], Columns] | None = None
    transform: Callable[[Motion, np.ndarray, dict[str, float]], np.ndarray] | None = None
    shapes: Callable[[np.random.Generator, Motion], dict[str, float]] = field(
        default=lambda rng, motion: {}
    )
    needs: dict[str, tuple[object, ...]] = field(default_factory=dict)
    joint: bool = False
    """All its parameters at once, never one alone."""


def _axes(first: int, prefix: str, size: float) -> dict[str, float]:
    return {f"{prefix}{a}": size for a in AXES}


def _own(first: int, prefix: str, make: Callable[[Motion, dict[str, float], int], np.ndarray]):
    def columns(motion: Motion, shape: dict[str, float]) -> Columns:
        return {f"{prefix}{a}": (first + i, make(motion, shape, i)) for i, a in enumerate(AXES)}

    return columns


def _warmth(m: Motion) -> np.ndarray:
    return m.temperature - m.temperature.mean()


def _slope(m: Motion) -> np.ndarray:
    return np.gradient(m.temperature, m.step)


def _moment(rng: np.random.Generator, motion: Motion) -> dict[str, float]:
    return {"moment": float(rng.uniform(0.2, 0.8) * motion.time[-1])}


def _warming(rng: np.random.Generator, motion: Motion) -> dict[str, float]:
    return {"tau": float(motion.time[-1] * np.exp(rng.uniform(np.log(0.06), np.log(0.4))))}


def _matrix_columns(prefix: str, source: str, pairs: list[tuple[int, int]]):
    def columns(motion: Motion, shape: dict[str, float]) -> Columns:
        values = getattr(motion, source)
        return {f"{prefix}{AXES[i]}{AXES[j]}": (3 + i, values[:, j]) for i, j in pairs}

    return columns


def _cross_product(motion: Motion, shape: dict[str, float]) -> Columns:
    f = motion.force
    out: Columns = {}
    for i in range(3):
        for j in range(3):
            if j != i:
                pair = "".join(sorted(AXES[i] + AXES[j]))
                out[f"k{AXES[i]}_{pair}"] = (i, f[:, i] * f[:, j])
    return out


def _size_effect(motion: Motion, shape: dict[str, float]) -> Columns:
    w = motion.rate
    dw = np.gradient(w, motion.step, axis=0)
    out: Columns = {}
    for j in range(3):
        e = np.eye(3)[j]
        term = np.cross(w, np.cross(w, e)) + np.cross(dw, e)
        for i in (1, 2):
            out[f"r{AXES[i]}{AXES[j]}"] = (i, term[:, i])
    return out


def _late(motion: Motion, values: np.ndarray, delay: float) -> np.ndarray:
    return np.interp(motion.time - delay, motion.time, values)


def _gyro_delay(motion: Motion, x: np.ndarray, p: dict[str, float]) -> np.ndarray:
    out = x.copy()
    for c in range(3, 6):
        out[:, c] = _late(motion, x[:, c], p["gyro_delay"])
    return out


def _skew(motion: Motion, x: np.ndarray, p: dict[str, float]) -> np.ndarray:
    out = x.copy()
    for name, delay in p.items():
        c = 3 * (name[:-2] == "gyro") + AXES.index(name[-1])
        out[:, c] = _late(motion, x[:, c], delay)
    return out


def _low_pass(motion: Motion, x: np.ndarray, p: dict[str, float]) -> np.ndarray:
    out = x.copy()
    n = len(x)
    size = 1 << int(np.ceil(np.log2(n + 2000)))
    s = 2j * np.pi * np.fft.rfftfreq(size, motion.step)
    for name, cutoff in p.items():
        if not name.endswith("cutoff"):
            continue
        first = 0 if name.startswith("accel") else 3
        w0 = 2 * np.pi * cutoff
        gain = (
            1 / (1 + s / w0) if p["order"] == 1 else 1 / (1 + np.sqrt(2) * s / w0 + (s / w0) ** 2)
        )
        for c in range(first, first + 3):
            # Around the circle it goes from the last value back to the first, far from both ends.
            pad = np.interp(np.arange(size - n), [0, size - n - 1], [x[-1, c], x[0, c]])
            ring = np.concatenate((x[:, c], pad))
            out[:, c] = np.fft.irfft(np.fft.rfft(ring) * gain, size)[:n]
    return out


WARM = ("warm_up", "ramp", "cycle")
OFF = [(i, j) for i in range(3) for j in range(3) if i != j]
ALL = [(i, j) for i in range(3) for j in range(3)]

EFFECTS: dict[str, Physics] = {
    "gyro_misalignment": Physics(
        {f"m{AXES[i]}{AXES[j]}": 0.01 for i, j in OFF}, _matrix_columns("m", "rate", OFF),
        needs={"misaligned": (False,)},
    ),
    "gyro_g_sensitivity": Physics(
        {f"g{AXES[i]}{AXES[j]}": 0.1 * DPS / G0 for i, j in ALL},
        _matrix_columns("g", "force", ALL),
        needs={"earth": (False,)},
    ),
    "gyro_g_squared_sensitivity": Physics(
        _axes(3, "g", 0.02 * DPS / G0**2), _own(3, "g", lambda m, s, i: m.force[:, i] ** 2)),
    "gyro_scale_asymmetry": Physics(
        _axes(3, "k", 1e-3), _own(3, "k", lambda m, s, i: np.abs(m.rate[:, i]))),
    "gyro_scale_quadratic": Physics(
        _axes(3, "k", 1e-3 / (360 * DPS)), _own(3, "k", lambda m, s, i: m.rate[:, i] ** 2)),
    "gyro_scale_nonlinearity": Physics(
        _axes(3, "k", 2e-3 / (360 * DPS) ** 2), _own(3, "k", lambda m, s, i: m.rate[:, i] ** 3)),
    "gyro_anisoinertia": Physics(
        _axes(3, "k", 0.1 * DPS / (200 * DPS) ** 2),
        _own(3, "k", lambda m, s, i: m.rate[:, i - 1] * m.rate[:, i - 2]),
        needs={"pose_style": ("random", "faces")},
    ),
    "gyro_bias_temperature": Physics(
        _axes(3, "k", 0.05 * DPS), _own(3, "k", lambda m, s, i: _warmth(m)),
        needs={"temperature": WARM}),
    "gyro_scale_temperature": Physics(
        _axes(3, "k", 2e-4), _own(3, "k", lambda m, s, i: _warmth(m) * m.rate[:, i]),
        needs={"temperature": WARM}),
    "gyro_temperature_rate": Physics(
        _axes(3, "k", 0.02 * DPS / 0.03), _own(3, "k", lambda m, s, i: _slope(m)),
        needs={"temperature": ("cycle",)}),
    "gyro_warm_up": Physics(
        _axes(3, "k", 0.1 * DPS), _own(3, "k", lambda m, s, i: np.exp(-m.time / s["tau"])),
        shapes=_warming),
    "gyro_bias_step": Physics(
        _axes(3, "b", 0.05 * DPS), _own(3, "b", lambda m, s, i: 1.0 * (m.time >= s["moment"])),
        shapes=_moment),
    "gyro_vibration_rectification": Physics(
        _axes(3, "k", 0.02 * DPS / G0**2),
        _own(3, "k", lambda m, s, i: m.vibration.sum(axis=1)),
        needs={"shaken": (True,)}),
    "accel_quadratic": Physics(
        _axes(0, "k", 3e-3 / G0), _own(0, "k", lambda m, s, i: m.force[:, i] ** 2)),
    "accel_cubic": Physics(
        _axes(0, "k", 2e-3 / G0**2), _own(0, "k", lambda m, s, i: m.force[:, i] ** 3)),
    "accel_cross_product": Physics(
        {f"k{AXES[i]}_{''.join(sorted(AXES[i] + AXES[j]))}": 2e-3 / G0 for i, j in OFF},
        _cross_product),
    "accel_scale_asymmetry": Physics(
        _axes(0, "k", 1e-3), _own(0, "k", lambda m, s, i: np.abs(m.force[:, i]))),
    "accel_bias_temperature": Physics(
        _axes(0, "k", 0.5 * MG), _own(0, "k", lambda m, s, i: _warmth(m)),
        needs={"temperature": WARM}),
    "accel_scale_temperature": Physics(
        _axes(0, "k", 2e-4), _own(0, "k", lambda m, s, i: _warmth(m) * m.force[:, i]),
        needs={"temperature": WARM}),
    "accel_temperature_rate": Physics(
        _axes(0, "k", MG / 0.03), _own(0, "k", lambda m, s, i: _slope(m)),
        needs={"temperature": ("cycle",)}),
    "accel_warm_up": Physics(
        _axes(0, "k", 5 * MG), _own(0, "k", lambda m, s, i: np.exp(-m.time / s["tau"])),
        shapes=_warming),
    "accel_bias_step": Physics(
        _axes(0, "b", 2 * MG), _own(0, "b", lambda m, s, i: 1.0 * (m.time >= s["moment"])),
        shapes=_moment),
    "accel_settling": Physics(
        _axes(0, "k", MG), _own(0, "k", lambda m, s, i: np.exp(-m.since_turn / s["tau"])),
        shapes=lambda rng, m: {"tau": float(np.exp(rng.uniform(np.log(0.5), np.log(3.0))))}),
    "accel_size_effect": Physics(
        {f"r{a}{b}": 1e-3 for a in "yz" for b in AXES}, _size_effect, joint=True),
    "accel_vibration_rectification": Physics(
        _axes(0, "k", 1e-3 / G0), _own(0, "k", lambda m, s, i: m.vibration[:, i]),
        needs={"shaken": (True,)}),
    "time_offset": Physics({"gyro_delay": 2e-3}, transform=_gyro_delay),
    "inter_axis_skew": Physics(
        {"accel_y": 5e-4, "accel_z": 1e-3, "gyro_y": 5e-4, "gyro_z": 1e-3}, transform=_skew,
        joint=True),
    "bandwidth": Physics({}, transform=_low_pass),
}  # fmt: skip
"""Effects by their slug in the catalogue. Readout effects are in `read_out`."""


# Outside the catalogue ---------------------------------------------------------------------------

Disturbance = tuple[dict[int, np.ndarray], tuple[float, float]]
"""What is added by channel, and where."""


def _window(
    rng: np.random.Generator, m: Motion, shares: tuple[float, float]
) -> tuple[float, float]:
    length = rng.uniform(*shares) * m.time[-1]
    begin = rng.uniform(0, m.time[-1] - length)
    return float(begin), float(begin + length)


def _inside(m: Motion, window: tuple[float, float]) -> np.ndarray:
    return (m.time >= window[0]) & (m.time < window[1])


def interference(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return a slow wave in one window, about zero or not."""
    window, c = _window(rng, m, (0.12, 0.4)), int(rng.integers(6))
    period, phase = np.exp(rng.uniform(np.log(4), np.log(60))), rng.uniform(0, 6)
    wave = np.sin(2 * np.pi * m.time / period + phase) + rng.choice([0.0, 1.0])
    return {c: _inside(m, window) * wave}, window


def loose_connector(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return jumps to and from at random in one window."""
    window, c = _window(rng, m, (0.12, 0.4)), int(rng.integers(6))
    edges = window[0] + np.cumsum(rng.exponential(rng.uniform(1, 6), 1000))
    values = rng.normal(size=1001)
    return {c: _inside(m, window) * values[np.searchsorted(edges, m.time)]}, window


def gain_window(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return a gain that differs in one window."""
    window, c = _window(rng, m, (0.15, 0.4)), int(rng.integers(6))
    own = (m.force if c < 3 else m.rate)[:, c % 3]
    return {c: _inside(m, window) * own}, window


def magnet(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return an output that saturates with the direction of a horizontal field: so of heading."""
    field_n = np.array([np.cos(0.4), 0.0, -np.sin(0.4)])
    seen = np.einsum("nji,j->ni", matrix(m.quaternion), field_n)
    c = int(rng.integers(3, 6))
    return {c: np.tanh(3 * seen[:, rng.integers(3)])}, (0.0, float(m.time[-1]))


def rate_crosstalk(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return the size of the rate, on one channel of the accelerometer."""
    return {int(rng.integers(3)): np.linalg.norm(m.rate, axis=1)}, (0.0, float(m.time[-1]))


def slipped_die(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return what one triad gains that turns against the other: at once, slowly, or and back."""
    first = 3 * int(rng.integers(2))
    signal = m.force if first == 0 else m.rate
    window = _window(rng, m, (0.15, 0.4))
    how = rng.integers(3)
    share = 1.0 * _inside(m, window)
    if how < 2:
        begin = float(rng.uniform(0.25, 0.7) * m.time[-1])
        pace = (window[1] - window[0]) if how else 1e-9
        share = np.clip((m.time - begin) / pace, 0, 1)
        window = (begin, float(m.time[-1]))
    turned = share[:, None] * np.cross(rng.normal(size=3), signal)
    return {first + i: turned[:, i] for i in range(3)}, window


def growing_gain(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return a gain that grows through one window and is then what it was."""
    window, c = _window(rng, m, (0.15, 0.4)), int(rng.integers(6))
    own = (m.force if c < 3 else m.rate)[:, c % 3]
    return {c: _inside(m, window) * (m.time - window[0]) / (window[1] - window[0]) * own}, window


def strained_by_speed(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return an output of one axis of the gyroscope while it turns fast about another."""
    c, other = rng.permutation(3)[:2]
    speed = np.abs(m.rate[:, other])
    return {3 + int(c): 1.0 * (speed > 0.4 * speed.max())}, (0.0, float(m.time[-1]))


def bumped_pose(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return a push on the accelerometer alone through one rest."""
    window = tuple(m.rests[int(rng.integers(2, len(m.rests) - 2))])
    push = rng.normal(size=3)
    return {c: _inside(m, window) * push[c] for c in range(3)}, window


def hum(rng: np.random.Generator, m: Motion) -> Disturbance:
    """Return a line on one channel, in one window or throughout."""
    window = _window(rng, m, (0.3, 0.6)) if rng.random() < 0.5 else (0.0, float(m.time[-1]))
    f = rng.uniform(3, 0.4 * m.setting.rate)
    wave = np.sin(2 * np.pi * f * m.time + rng.uniform(0, 6))
    return {int(rng.integers(6)): _inside(m, window) * wave}, window


OUTSIDE: dict[str, Callable[[np.random.Generator, Motion], Disturbance]] = {
    f.__name__: f
    for f in (
        interference, loose_connector, gain_window, magnet, rate_crosstalk, bumped_pose, hum,
        slipped_die, growing_gain, strained_by_speed,
    )
}  # fmt: skip


# Sensor ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Errors:
    """Moderate calibration errors: what every tool models."""

    accel: np.ndarray
    gyro: np.ndarray
    bias: np.ndarray


def draw_errors(rng: np.random.Generator, setting: Setting) -> Errors:
    """Return scale 1 %, non-orthogonality 0.5 %, and a gyro misalignment if the setting has one."""
    size = 0.2 if setting.part.name == "tactical" else 1.0
    accel = np.diag(rng.normal(0, 0.01 * size, 3)) + np.tril(rng.normal(0, 5e-3 * size, (3, 3)), -1)
    gyro = np.diag(rng.normal(0, 0.012 * size, 3))
    if setting.misaligned:
        off = rng.normal(0, 0.01 * size, (3, 3))
        gyro = gyro + off - np.diag(np.diag(off))
    bias = np.concatenate((rng.normal(0, 0.2 * size, 3), rng.normal(0, 1.0 * DPS * size, 3)))
    return Errors(np.eye(3) + accel, np.eye(3) + gyro, bias)


def ideal(motion: Motion, errors: Errors) -> np.ndarray:
    """Return the fine (n, 6) output without noise, before any effect."""
    pair = (motion.force @ errors.accel.T, motion.rate @ errors.gyro.T)
    return np.concatenate(pair, axis=1) + errors.bias


def distort(
    motion: Motion, output: np.ndarray, slug: str, parameters: dict[str, float]
) -> np.ndarray:
    """Return the fine output with one effect of the catalogue in it."""
    physics = EFFECTS[slug]
    if physics.transform is not None:
        return physics.transform(motion, output, parameters)
    assert physics.columns is not None
    out = output.copy()
    for name, (channel, column) in physics.columns(motion, parameters).items():
        if parameters.get(name):
            out[:, channel] += parameters[name] * column
    return out


def noise(rng: np.random.Generator, motion: Motion, count: int) -> np.ndarray:
    """Return white noise and drift, (count, 6): four Gauss-Markov processes and a walk each."""
    setting, part = motion.setting, motion.setting.part
    out = np.empty((count, 6))
    seconds = count / setting.rate
    node = np.arange(int(seconds * 5) + 2) / 5
    taus = np.array([2.0, 20.0, 200.0, 2000.0])
    for c in range(6):
        triad = c // 3
        decay = np.exp(-0.2 / taus)
        level = 0.6 * setting.drift * part.instability[triad] * rng.uniform(0.6, 1.4)
        state = level * rng.normal(size=4)
        kicks = level * np.sqrt(1 - decay**2) * rng.normal(size=(len(node), 4))
        path = np.empty(len(node))
        for k, kick in enumerate(kicks):
            path[k] = state.sum()
            state = decay * state + kick
        path += (
            setting.drift * part.walk[triad] * np.sqrt(0.2) * np.cumsum(rng.normal(size=len(node)))
        )
        white = part.density[triad] * np.sqrt(setting.rate / 2) * rng.normal(size=count)
        out[:, c] = white + np.interp(np.arange(count) / setting.rate, node, path)
    return out


def read_out(
    motion: Motion,
    output: np.ndarray,
    *,
    full_scale: tuple[float, float] = (np.inf, np.inf),
    lsb: tuple[float, float] | None = None,
    lost: tuple[float, int] | None = None,
    factor: tuple[float, float] = (1.0, 1.0),
    order: tuple[int, int, int] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, output (n, 6) and temperature as they are logged.

    `lost` is (moment, count): so many samples vanish, and the clock, which counts samples, does not
    know. `factor` and `order` are a wrong unit and wrong axes of the gyroscope.
    """
    setting = motion.setting
    out = np.array(output)
    steps = lsb or ((0.0, 0.0) if setting.exact else setting.part.lsb)
    for triad in range(2):
        c = slice(3 * triad, 3 * triad + 3)
        out[:, c] = np.clip(out[:, c], -full_scale[triad], full_scale[triad])
        if steps[triad]:
            out[:, c] = np.round(out[:, c] / steps[triad]) * steps[triad]
        out[:, c] *= factor[triad]
    temperature = motion.pick(motion.temperature)[: len(out)]
    if lost is not None:
        at = round(lost[0] * setting.rate)
        keep = np.delete(np.arange(len(out)), slice(at, at + lost[1]))
        out, temperature = out[keep], temperature[keep]
    if order is not None:
        signs = np.sign(np.array(order))
        out[:, 3:] = out[:, 3:][:, np.abs(order) - 1] * signs
    time = np.arange(len(out)) / setting.rate
    late = np.random.default_rng(len(out)).uniform(-setting.late, setting.late, len(out))
    return setting.start + time + late, out, temperature


Log = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time, output (n, 6) and temperature, as they are logged."""


def read_faster(rng: np.random.Generator, log: Log) -> Log:
    """Return what a host has that asks for the last sample up to three times as often."""
    time, output, temperature = log
    step = float(np.median(np.diff(time))) / rng.uniform(1.2, 3.0)
    asked = np.arange(time[0], time[-1], step)
    last = np.searchsorted(time, asked, side="right") - 1
    return asked, output[last], temperature[last]


def hold(first: int) -> Callable[[np.random.Generator, Log], Log]:
    """Return what holds each second sample of a triad, from channel `first` on."""

    def held(_: np.random.Generator, log: Log) -> Log:
        time, output, temperature = log
        own, out = slice(first, first + 3), np.array(output)
        out[1::2, own] = output[:-1:2, own][: len(out[1::2])]
        return time, out, temperature

    return held


def spike(rng: np.random.Generator, log: Log) -> Log:
    """Return a log in which a dozen values, alone or up to three at a time, are wrong."""
    time, output, temperature = log
    out = np.array(output)
    for at in rng.integers(10, len(time) - 10, 12):
        some = slice(at, at + int(rng.integers(1, 4)))
        out[some, rng.integers(6)] += rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 8.0)
    return time, out, temperature


READ: dict[str, Callable[[np.random.Generator, Log], Log]] = {
    "well": lambda _, log: log,
    "faster": read_faster,
    "accel_held": hold(0),
    "gyro_held": hold(3),
    "spikes": spike,
}
"""How a log was read."""


def write_csv(
    path: Path,
    time: np.ndarray,
    output: np.ndarray,
    temperature: np.ndarray | None,
    rng: np.random.Generator,
) -> None:
    """Write SI columns; the thermometer has 0.03 K of noise and counts of 1/340 K."""
    names = ["time"] + [f"{t}_{a}" for t in ("accel", "gyro") for a in AXES]
    table = np.column_stack((time, output))
    line = "%.6f" + ",%.9g" * 6
    if temperature is not None:
        names.append("temperature")
        seen = np.round((temperature + 0.03 * rng.normal(size=len(time))) * 340) / 340
        table = np.column_stack((table, seen))
        line += ",%.4f"
    with open(path, "w") as file:
        file.write(",".join(names) + "\n")
        for block in np.array_split(table, max(1, len(table) // 20_000)):
            file.write((line + "\n") * len(block) % tuple(block.ravel()))
