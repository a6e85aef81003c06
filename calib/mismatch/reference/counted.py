"""What rounding to coarse counts does to rests that are compared.

Motion sweeps over counts, and rounding is noise there. At rest a sensor stays at one place between
two counts, and where its noise is less than half of one, means are off by what it rounds to: alike
whenever the place is the same one. A gyroscope is at its bias in all rests, and beside a truth that
would go with the speed of rotation, or be an end of its scale.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.reference.stilled import find_rests
from calib.mismatch.samples.coarse import coarse_channels
from calib.recording import CHANNELS, Recording
from calib.types import FloatArray


def rounded_at_rest(
    real: Recording, time: FloatArray, rate: FloatArray, findings: Sequence[Finding]
) -> tuple[sparse.csr_matrix, ...]:
    """Return six sparse (n, k) matrices of errors, as `with_rounding` takes them.

    What means at rest err by, an axis of the gyroscope also errs by while it turns by less than
    rounds to nothing. Each rest tells its place by itself, and roughly; a bias has the same one in
    all of them, and is off by as much in all.

    Parameters
    ----------
    real : Recording
    time : (n,) array, s
        Of what is compared.
    rate : (n, 3) array, rad/s
        As the truth has it then.
    findings : sequence of Finding
        Channels of which the counts are coarse are among them. Without any nothing is returned.
    """
    poses = find_rests(real)
    edges = np.stack((real.time[poses.start], real.time[poses.stop - 1]), axis=1)
    coarse = coarse_channels(real, edges, findings) if len(edges) else {}
    if not coarse:
        return ()
    nearest = np.searchsorted(0.5 * (edges[1:, 0] + edges[:-1, 1]), time)
    rests = (time >= edges[nearest, 0]) & (time <= edges[nearest, 1])
    shape = len(time), len(edges)
    out = [sparse.csr_matrix((len(time), 1)) for _ in CHANNELS]
    for c, rounding in coarse.items():
        stays = rests if c < 3 else rests | (np.abs(rate[:, c - 3]) <= 0.5 * rounding.lsb)
        size, along = np.linalg.eigh(rounding.covariance)
        apart = along * np.sqrt(np.maximum(size, 0.0)), np.diag(np.sqrt(rounding.variance))
        alike = np.full(len(edges), np.sqrt(rounding.total.mean()) * (c >= 3))
        at = np.flatnonzero(stays)
        member = sparse.csr_matrix((np.ones(len(at)), (at, nearest[at])), shape=shape)
        errors = np.column_stack((alike, rounding.error, *apart))
        out[c] = sparse.csr_matrix(member @ sparse.csr_matrix(errors))
    return tuple(out)
