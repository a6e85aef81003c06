"""What an oracle that knows motion, noise and the shape of an effect could see: numpy only.

The effect's signal goes through the linear equations of rests and turns: mean outputs in bins of
each rest, the horizontal attitude after each turn, the velocity after each turn (the sensor rests
at both ends). Bias, scale factors, the accelerometer's non-orthogonality and two angles of attitude
per pose are projected out; what is left, squared in units of its noise (white and drift), is the
non-centrality.

It knows how the sensor moved, but nobody who has samples alone knows what a turn did between them.
By how much samples without any noise fail to close a turn counts as noise of that turn's equations:
the size of it, not its direction. At 50 Hz that can be twice what white noise does to a velocity.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from _independent_generator import EARTH, Motion, exponential, matrix, multiply

EDGES = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 1e3])


class Oracle:
    """Non-centrality of signals on one motion."""

    def __init__(self, motion: Motion) -> None:
        self.dt = 1 / motion.setting.rate
        self.mat = matrix(motion.pick(motion.quaternion))
        self.mat /= np.linalg.norm(self.mat, axis=-1, keepdims=True)
        force, rate = motion.pick(motion.force), motion.pick(motion.rate)
        self.n = len(force)
        world = np.einsum("nij,nj->ni", self.mat, force)
        setting, part = motion.setting, motion.setting.part
        sigma2 = np.repeat(np.square(part.density) * setting.rate / 2, 3)
        shake = motion.pick(motion.vibration)
        rests = np.round(motion.rests / self.dt).astype(int)
        poses = len(rests)
        self._blocks: list[tuple[slice, np.ndarray]] = []  # samples, weights (rows, m, 6)
        nuisance: list[np.ndarray] = []
        white: list[np.ndarray] = []
        up = np.array([0, 0, setting.gravity])
        for i, (a, b) in enumerate(rests):
            edges = np.unique(np.clip((a + EDGES / self.dt).astype(int), a, b))
            if len(edges) > 2 and edges[-1] - edges[-2] < 0.2 / self.dt:
                edges = np.delete(edges, -2)
            for p, q in pairwise(edges):
                weights = np.zeros((6, q - p, 6))
                weights[range(6), :, range(6)] = 1 / (q - p)
                tilt = np.zeros((6, 2 * poses))
                tilt[:3, 2 * i : 2 * i + 2] = self.mat[p].T @ np.cross(np.eye(3)[:2], up).T
                self._blocks.append((slice(p, q), weights))
                nuisance.append(tilt)
                more = np.concatenate((shake[p:q].mean(axis=0), np.zeros(3)))
                white.append(np.diag((sigma2 + more) / (q - p)))
        for i in range(poses - 1):
            a, b = rests[i, 1], rests[i + 1, 0]
            m = b - a
            r = self.mat[a:b] * self.dt
            done = np.cumsum(world[a:b] * self.dt, axis=0)
            left = done[-1] - done
            weights = np.zeros((5, m, 6))
            weights[:2, :, 3:] = r[:, :2].transpose(1, 0, 2)
            weights[2:, :, :3] = r.transpose(1, 0, 2)
            # R dw x (velocity still to come)
            weights[2:, :, 3:] = np.cross(r, left[:, :, None], axisa=1, axisb=1, axisc=0)
            tilt = np.zeros((5, 2 * poses))
            tilt[:2, 2 * i : 2 * i + 2] = np.eye(2)
            tilt[:2, 2 * i + 2 : 2 * i + 4] = -np.eye(2)
            tilt[2:, 2 * i : 2 * i + 2] = np.cross(np.eye(3)[:2], done[-1]).T
            self._blocks.append((slice(a, b), weights))
            nuisance.append(tilt)
            own = np.einsum("imc,jmc,c->ij", weights, weights, sigma2)
            white.append(own + np.diag(np.repeat(_unclosed(motion, a - 2, b + 2), (2, 3))))
        sizes = [len(w) for w in white]
        ends = np.cumsum(sizes)
        covariance = np.zeros((ends[-1], ends[-1]))
        reply = np.zeros((ends[-1], 6, len(sizes)))
        for k, (w, (_, weights)) in enumerate(zip(white, self._blocks, strict=True)):
            own = slice(ends[k] - sizes[k], ends[k])
            covariance[own, own] = w
            reply[own, :, k] = weights.sum(axis=1)
        middle = np.array([0.5 * (s.start + s.stop) for s, _ in self._blocks]) * self.dt
        lag = np.abs(middle[:, None] - middle)
        early = np.minimum(middle[:, None], middle)
        for c in range(6):
            level = 0.6 * setting.drift * part.instability[c // 3]
            kernel = sum(level**2 * np.exp(-lag / tau) for tau in (2.0, 20.0, 200.0, 2000.0))
            kernel = kernel + (setting.drift * part.walk[c // 3]) ** 2 * early
            covariance += reply[:, c] @ kernel @ reply[:, c].T
        self._root = np.linalg.cholesky(covariance)
        base = []
        for triad, signal in ((0, force), (1, rate)):
            for i in range(3):
                for j in range(3):
                    free = i == j or (j < i if triad == 0 else motion.setting.misaligned)
                    if free:
                        base.append(self._rows({3 * triad + i: signal[:, j]}))
                base.append(self._rows({3 * triad + i: np.ones(self.n)}))
        known = np.hstack((np.column_stack(base), np.vstack(nuisance)))
        self._known, _ = np.linalg.qr(np.linalg.solve(self._root, known))

    def _rows(self, signal: dict[int, np.ndarray]) -> np.ndarray:
        """Return the rows of a signal given by channel."""
        parts = []
        for samples, weights in self._blocks:
            parts.append(sum(weights[:, :, c] @ values[samples] for c, values in signal.items()))
        return np.concatenate(parts)

    def power(self, signal: np.ndarray) -> tuple[float, float]:
        """Return the non-centrality of an (n, 6) signal, and before baseline absorbed its part."""
        rows = self._rows({c: signal[: self.n, c] for c in range(6)})
        white = np.linalg.solve(self._root, rows)
        left = white - self._known @ (self._known.T @ white)
        return float(left @ left), float(white @ white)


def _unclosed(motion: Motion, a: int, b: int) -> tuple[float, float]:
    """Return the mean squares by which samples a to b, from rest to rest, miss tilt and velocity.

    Of each integral a cubic through four samples is taken, of rotations that do not commute the
    next term as well.
    """
    dt = 1 / motion.setting.rate
    mat = matrix(motion.pick(motion.quaternion)[a:b])
    mat /= np.linalg.norm(mat, axis=-1, keepdims=True)
    force, rate = (motion.pick(x)[a:b] for x in (motion.force, motion.rate))
    if motion.setting.earth:
        north = np.sqrt(EARTH**2 - motion.earth_up**2)
        rate = rate - np.einsum("nji,j->ni", mat, [0, north, motion.earth_up])
    turn = _integral(rate) * dt + dt**2 / 12 * np.cross(rate[:-1], rate[1:])
    chain = [np.array([1.0, 0, 0, 0])]
    for step in exponential(turn):
        chain.append(multiply(chain[-1], step))
    frame = mat[0] @ matrix(np.array(chain))
    tilt = 0.5 * np.cross(frame[-1].T, mat[-1].T).sum(axis=0)[:2]
    up = np.array([0, 0, motion.setting.gravity])
    velocity = (_integral(np.einsum("nij,nj->ni", frame, force) - up) * dt).sum(axis=0)
    return float(np.square(tilt).mean()), float(np.square(velocity).mean())


def _integral(values: np.ndarray) -> np.ndarray:
    """Return the integral over each step between samples, in steps."""
    ends = np.concatenate((values[:1], values, values[-1:]))
    return (13 * (ends[1:-2] + ends[2:-1]) - ends[:-3] - ends[3:]) / 24
