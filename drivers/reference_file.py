"""Reference files: motion capture, a table's profile, or another recording.

======== ======================================================================================
HDF5     ``opt_quat`` (n, 4) and, if positions were captured, ``opt_pos`` (n, 3) in m, with the
         attribute ``sampling_rate`` in Hz (as BROAD has them)
CSV      columns ``time`` (s), ``qw qx qy qz`` and, if known, ``x y z`` (m); empty cells,
         ``nan`` and quaternions of zeros are gaps. Without positions the body counts as
         carried, and the accelerometer is judged at rest only, but where it turns about one axis
         alone or is said to be fixed
CSV      columns ``time`` (s) and one of ``angle`` (rad), ``angle_deg``, ``rate`` (rad/s),
         ``rate_dps``: a table that turns about a vertical axis. It may turn by any angle from row
         to row, but where all angles are within one turn: then they count as wrapped
others   any recording: another IMU on the same body
======== ======================================================================================
"""

from __future__ import annotations

import csv
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.errors import RecordingFormatError, RecordingNotFoundError
from calib.recording import Recording
from calib.simulation.through import DEGREE
from drivers.formats import read_recording

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

    from calib.mismatch.reference.referencemode import ReferenceMotion
    from calib.types import FloatArray

QUATERNION = ("qw", "qx", "qy", "qz")
POSITION = ("x", "y", "z")
TABLE = ("angle", "angle_deg", "rate", "rate_dps")
FORCE = {"ax", "accel_x"}
"""A file that has one of these is the log of an IMU, whatever else is in it."""
FARTHEST = np.radians(30.0)
"""By which a table may turn from row to row before there are rows between: a spline through
orientations is exact then, and from 180 degrees on they tell nothing of which way it turned."""
MOST_ROWS = 1e7
"""Of a table with rows between: a day at 100 Hz."""
FEWEST = 4
"""Rows that tell how anything moved."""
HDF5 = b"\x89HDF\r\n\x1a\n"


def read_reference(
    path: Path,
    *,
    imu: int | None = None,
    profile: str | None = None,
    fixed: bool = False,
    drop_invalid: bool = False,
) -> Recording | ReferenceMotion:
    """Read a reference.

    Parameters
    ----------
    path : Path
    imu : int, optional
        Which sensor of a board, where the reference is another IMU.
    profile : str, optional
        Import profile of the other IMU's log; the reference then is one.
    fixed : bool
        Whether its orientations are said to be those of a body that turns about a fixed point.
    drop_invalid : bool
        Turn invalid rows of another IMU's log into gaps.

    Raises
    ------
    RecordingError
        If it is none of the above; the message names what was seen and expected.
    """
    found = _read(path, imu=imu, profile=profile, drop_invalid=drop_invalid)
    if not fixed:
        return found
    if isinstance(found, Recording) or found.position is not None:
        seen = "another IMU" if isinstance(found, Recording) else "positions"
        raise RecordingFormatError(
            f"{path}: it has {seen}, expected orientations alone where the point is said to be "
            "fixed"
        )
    return replace(found, fixed=True)


def read_motion(path: Path, *, fixed: bool = False) -> ReferenceMotion:
    """Read a reference that knows how the body moved.

    Raises
    ------
    RecordingError
        Also if it is another IMU, which knows what it felt.
    """
    found = read_reference(path, fixed=fixed)
    if isinstance(found, Recording):
        raise RecordingFormatError(
            f"{path}: it is the recording of an IMU, whose motion is known only through its "
            f"calibration; expected motion capture or a table's profile (or give "
            f"--like {path.name} with --calibration)"
        )
    return found


def _read(
    path: Path, *, imu: int | None, profile: str | None, drop_invalid: bool
) -> Recording | ReferenceMotion:
    if not path.is_file() or profile is not None:
        if not path.exists():
            raise RecordingNotFoundError(f"{path}: there is no such reference")
        return read_recording(path, imu=imu, profile=profile, drop_invalid=drop_invalid)
    head = _head(path)
    if head.startswith(HDF5):
        captured = _hdf5(path)
        if captured is not None:
            return captured
    names = _header(head)
    if _has_orientations(names):
        return _captured(path, _columns(path, names))
    if _has_angles(names):
        return _table(path, _columns(path, names))
    return read_recording(path, imu=imu, drop_invalid=drop_invalid)


def refuse_reference(path: Path) -> None:
    """Refuse a text file that says how a body moved where what an IMU felt is expected.

    Raises
    ------
    RecordingFormatError
    """
    names = _header(_head(path)) if path.is_file() else []
    if (_has_orientations(names) or _has_angles(names)) and not FORCE & set(names):
        raise RecordingFormatError(
            f"{path}: it says how a body moved, expected what an IMU measured; give motion capture "
            f"or a table's profile as a reference (diagnose RECORDING --reference {path.name})"
        )


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4096)


def _has_orientations(names: list[str]) -> bool:
    return "time" in names and set(QUATERNION) <= set(names)


def _has_angles(names: list[str]) -> bool:
    return "time" in names and bool(set(TABLE) & set(names)) and not FORCE & set(names)


def _header(head: bytes) -> list[str]:
    first = head.decode("utf-8", "replace").lstrip("\ufeff").split("\n", 1)[0]
    return [name.strip().lower() for name in first.split(",")]


def _columns(path: Path, names: list[str]) -> dict[str, FloatArray]:
    values: list[list[float]] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for number, row in enumerate(islice(csv.reader(file), 1, None), 2):
            if not row:
                continue
            try:
                values.append([float(cell) if cell.strip() else np.nan for cell in row])
            except ValueError:
                raise RecordingFormatError(
                    f"{path}: line {number} holds {row!r}, expected {len(names)} numbers"
                ) from None
            if len(row) != len(names):
                raise RecordingFormatError(
                    f"{path}: line {number} has {len(row)} cells, expected {len(names)} "
                    f"({', '.join(names)})"
                )
    if len(values) < FEWEST:
        raise RecordingFormatError(f"{path}: it has {len(values)} rows, expected at least {FEWEST}")
    found = dict(zip(names, np.array(values, np.float64).T, strict=True))
    time = found["time"]
    if not np.isfinite(time).all() or np.diff(time).min() <= 0:
        k = int(np.argmax(~(np.diff(time) > 0))) + 3
        raise RecordingFormatError(f"{path}: time must increase, and does not at line {k}")
    return found


def _captured(path: Path, columns: dict[str, FloatArray]) -> ReferenceMotion:
    from calib.mismatch.reference.referencemode import ReferenceMotion

    there = [name for name in POSITION if name in columns]
    if there and len(there) < 3:
        raise RecordingFormatError(
            f"{path}: of the position only {', '.join(there)} is there, expected x, y and z or none"
        )
    position = np.stack([columns[n] for n in POSITION], axis=1) if there else None
    quat = np.stack([columns[n] for n in QUATERNION], axis=1)
    return ReferenceMotion(columns["time"], _unit(path, quat), position)


def _table(path: Path, columns: dict[str, FloatArray]) -> ReferenceMotion:
    from calib.mismatch.reference.referencemode import ReferenceMotion

    given = [name for name in TABLE if name in columns]
    if len(given) > 1:
        raise RecordingFormatError(
            f"{path}: it has {' and '.join(given)}, expected one of {', '.join(TABLE)}"
        )
    time, values = columns["time"], columns[given[0]]
    if given[0].endswith(("_deg", "_dps")):
        values = np.radians(values)
    if given[0].startswith("rate"):
        _refuse_gaps(path, time, values)
        spline = _settled_spline(time, values).antiderivative()
        values = spline(time - time[0])
    else:
        values = _unwrapped(values)
        known = np.isfinite(values)
        if known.sum() < FEWEST:
            raise RecordingFormatError(
                f"{path}: {given[0]} is given in {known.sum()} rows, expected at least {FEWEST}"
            )
        spline = _settled_spline(time[known], values[known])
    time, values = _finer(path, time, values, spline)
    quat = np.zeros((len(time), 4))
    quat[:, 0], quat[:, 3] = np.cos(0.5 * values), np.sin(0.5 * values)
    return ReferenceMotion(time, quat, fixed=True)


def _refuse_gaps(path: Path, time: FloatArray, rate: FloatArray) -> None:
    known = np.isfinite(rate)
    if not known.all():
        raise RecordingFormatError(
            f"{path}: the rate is missing at {time[~known][0]:.6g} s; after a gap the angle is not "
            "known: give the angle instead"
        )


def _unwrapped(angle: FloatArray) -> FloatArray:
    """Return angles that do not jump by turns, if all of them are within one; nan are gaps."""
    known = np.isfinite(angle)
    if not known.any() or np.ptp(angle[known]) > 2 * np.pi:
        return angle
    out = angle.copy()
    out[known] = np.unwrap(angle[known])
    return out


def _settled_spline(time: FloatArray, values: FloatArray) -> BSpline:
    """Return the spline, over time since the first, through a table's values (n,).

    Straight lines would lose 0.2 % of the rate where a table speeds up, at 20 Hz. At either end it
    settles: a table rests or turns steadily there, and a spline whose ends are free rings where it
    speeds up within a few rows of them.
    """
    from scipy.interpolate import make_interp_spline  # a third of a second to import

    ends = [(order, 0.0) for order in range((DEGREE + 1) // 2, DEGREE)]
    return make_interp_spline(time - time[0], values, k=DEGREE, bc_type=(ends, ends))


def _finer(
    path: Path, time: FloatArray, angle: FloatArray, spline: BSpline
) -> tuple[FloatArray, FloatArray]:
    """Return rows that are near enough for orientations, which repeat with every turn.

    What is between two rows is that of the spline, over time since the first angle; gaps stay.
    """
    seen = np.flatnonzero(np.isfinite(angle))
    turned = np.abs(np.diff(angle[seen])) / np.diff(seen)
    if turned.max() <= FARTHEST:
        return time, angle
    count = np.ceil(turned.max() / FARTHEST) * (len(time) - 1)
    if count > MOST_ROWS:
        raise RecordingFormatError(
            f"{path}: the table turns by {np.degrees(turned.max()):.4g} degrees in a row to "
            f"{time[seen[turned.argmax() + 1]]:.6g} s, expected rows that are nearer to each other"
        )
    row = np.arange(len(time), dtype=float)
    between = np.linspace(0.0, row[-1], int(count) + 1)
    at = np.interp(between, row, time)
    out = np.asarray(spline(at - time[seen[0]]))
    out[~np.isfinite(np.interp(between, row, angle))] = np.nan
    return at, out


def _unit(path: Path, quat: FloatArray) -> FloatArray:
    """Return quaternions of length 1; those that are zero, as of a body out of sight, are nan."""
    size = np.linalg.norm(quat, axis=1)
    good = np.isfinite(size) & (size > 0)
    if not good.any() or np.abs(size[good] - 1).max() > 0.05:
        seen = f"{size[good].min():.3g} to {size[good].max():.3g}" if good.any() else "none"
        raise RecordingFormatError(
            f"{path}: lengths of the quaternions are {seen}, expected 1 (scalar first: qw, qx, qy, "
            "qz)"
        )
    out: FloatArray = quat / np.where(good, size, np.nan)[:, None]
    return out


def _hdf5(path: Path) -> ReferenceMotion | None:
    """Return the captured motion of an HDF5 file, None if it holds none."""
    import h5py

    from calib.mismatch.reference.referencemode import ReferenceMotion

    try:
        with h5py.File(path) as file:
            if "opt_quat" not in file:
                return None
            quat = np.asarray(file["opt_quat"], np.float64)
            position = np.asarray(file["opt_pos"], np.float64) if "opt_pos" in file else None
            rate = float(file.attrs.get("sampling_rate", np.nan))
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise RecordingFormatError(f"{path}: the HDF5 file is damaged ({error})") from error
    if quat.ndim != 2 or quat.shape[1] != 4 or len(quat) < FEWEST:
        raise RecordingFormatError(f"{path}: opt_quat is {quat.shape}, expected (n, 4)")
    if position is not None and position.shape != (len(quat), 3):
        raise RecordingFormatError(
            f"{path}: opt_pos is {position.shape}, expected {(len(quat), 3)}"
        )
    if not (np.isfinite(rate) and rate > 0):
        raise RecordingFormatError(f"{path}: the attribute sampling_rate (Hz) is missing")
    return ReferenceMotion(np.arange(len(quat)) / rate, _unit(path, quat), position)
