"""Evidence that a disturbance wanders in a window, for every window at once.

A disturbance that nobody has a name for is a stationary process x(t) with a correlation time,
switched on at one end of a window and off at the other:

    x[k] = rho[k] x[k-1] + sqrt(1 - rho[k]²) e[k],    x[first] = e[first],    e ~ N(0, s²)

For a fixed end, the column of each ``e[m]`` is the same wherever the window begins, but that the
first has no factor. So the Cholesky factor of ``I + s² Z'Z``, ordered from the end backwards, holds
the evidence of all windows with that end.

References
----------
.. [1] Rasmussen, Williams, "Gaussian Processes for Machine Learning", 2006, app. B.2
   (Ornstein-Uhlenbeck process and its regression form).
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.hypotheses.factors import SCALES, average_of_scales
from calib.types import FloatArray, IntArray


def wandering(
    gram: FloatArray,
    match: FloatArray,
    middle: FloatArray,
    first: IntArray,
    *,
    correlation: float,
    longest: int,
) -> FloatArray:
    """Return log B of a disturbance that wanders in each window, (s + 1, s + 1).

    Element ``[a, b]`` is that of the segments ``[a, b)``; -inf of windows that are longer.

    Parameters
    ----------
    gram : (n, c, n, c) array
        Products of the whitened columns of n slots on c channels.
    match : (n, c) array
        Their products with the residual.
    middle : (n,) array, s
    first : (s + 1,) array of int
        The first slot of each segment.
    correlation : float, s
    longest : int
        Segments of a window, at most.
    """
    c = match.shape[1]
    segments = len(first) - 1
    lag = np.subtract.outer(middle, middle)
    decay = np.triu(np.exp(-np.abs(lag) / correlation))
    # What each e adds beyond what came before it; the first adds all.
    size = np.sqrt(-np.expm1(-2.0 * np.diff(middle, prepend=middle[0] - 1.0) / correlation))
    out = np.full((segments + 1, segments + 1), -np.inf)
    scale = np.square(SCALES)[:, None, None]
    for b in range(1, segments + 1):
        begins = np.arange(max(b - longest, 0), b)
        low, high = int(first[begins[0]]), int(first[b])
        k = high - low
        pull = decay[low:high, low:high]
        # Later slots first: rows and columns (slot, channel) of pull G pull'.
        one = (pull @ gram[low:high, :, low:high].reshape(k, -1)).reshape(k, c, k, c)
        both = np.matmul(pull, one.reshape(k * c, k, c)).reshape(k, c, k, c)
        inner = both[::-1, :, ::-1].reshape(k * c, k * c)
        along = (pull @ match[low:high])[::-1].reshape(k * c)
        each = np.repeat(size[low:high][::-1], c)
        whole = np.zeros((len(SCALES), k * c + 1, k * c + 1))
        whole[:, :-1, :-1] = scale * (inner * np.outer(each, each)) + np.eye(k * c)
        whole[:, -1, :-1] = whole[:, :-1, -1] = SCALES[:, None] * (along * each)
        whole[:, -1, -1] = 1.0 + np.square(whole[:, -1, :-1]).sum(axis=1)
        root = np.linalg.cholesky(whole)
        left, diagonal = root[:, -1, :-1], np.diagonal(root, axis1=1, axis2=2)[:, :-1]
        gain = 0.5 * np.square(left) - np.log(diagonal)
        before = np.zeros((len(SCALES), k + 1))
        before[:, 1:] = gain.reshape(-1, k, c).sum(axis=2).cumsum(axis=1)
        # The slot that each window begins with has no factor.
        at = high - 1 - first[begins]
        own = at[:, None] * c + np.arange(c)
        block = root[:, own[:, :, None], own[:, None]]
        s = size[first[begins], None, None]
        full = (block @ np.swapaxes(block, 2, 3) - np.eye(c)) / s**2 + np.eye(c)
        value = block @ (left[:, own, None] / s)
        solved = np.linalg.solve(full, value)
        last = 0.5 * (value * solved).sum(axis=(2, 3)) - 0.5 * np.linalg.slogdet(full)[1]
        out[begins, b] = average_of_scales(before[:, at] + last)
    return out
