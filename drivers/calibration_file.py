"""Calibrations on disk: JSON, written so that there is never half a file."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import tempfile
from pathlib import Path
from typing import NoReturn

from calib.calibration import Calibration, InputFile
from calib.document import from_document, to_document
from calib.errors import CalibrationFileError
from drivers.output_file import can_replace


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration.

    Raises
    ------
    CalibrationFileError
        If the file is missing, is no JSON or only part of one, or is no calibration that this
        version reads; the message names the file.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CalibrationFileError(f"{path}: cannot read it: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise CalibrationFileError(f"{path}: not a calibration: it is not text") from error
    if not text.strip():
        raise CalibrationFileError(f"{path}: the file is empty, expected a calibration (JSON)")
    try:
        document = json.loads(text, parse_constant=_no_constant)
    except json.JSONDecodeError as error:
        end = len(text.rstrip())
        cut = error.pos >= end or error.msg.startswith("Unterminated string")
        what = "the file is cut: JSON ends early" if cut else "not JSON"
        raise CalibrationFileError(
            f"{path}: {what} at line {error.lineno}, column {error.colno} ({error.msg}); "
            "restore it from a copy, or calibrate again"
        ) from error
    except RecursionError as error:
        raise CalibrationFileError(f"{path}: not a calibration: lists within lists") from error
    except CalibrationFileError as error:
        raise CalibrationFileError(f"{path}: {error}") from error
    try:
        return from_document(document)
    except CalibrationFileError as error:
        raise CalibrationFileError(f"{path}: {error}") from error


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration, whole or not at all.

    Raises
    ------
    CalibrationFileError
        If it cannot be written; what was there before is then untouched.
    """
    text = json.dumps(to_document(calibration), indent=2, ensure_ascii=False, allow_nan=False)
    write_atomic(Path(path), _compact_rows(text) + "\n")


def check_can_save(calibration: Calibration, path: Path) -> None:
    """Raise what saving it there would raise, as far as a trial beside it can tell.

    Raises
    ------
    CalibrationFileError
        If it could not be written; nothing is left behind.
    """
    if not can_replace(path):
        check_can_write(path)
        return
    try:
        with tempfile.TemporaryDirectory(dir=path.resolve().parent) as folder:
            save_calibration(calibration, Path(folder) / path.name)
    except (CalibrationFileError, OSError) as error:
        raise CalibrationFileError(f"{path}: a trial to write beside it failed: {error}") from error


def check_can_write(path: Path) -> None:
    """Raise what writing a file there would raise, before work of which it is the result.

    Raises
    ------
    CalibrationFileError
        If there is no such folder, or nothing can be written in it; nothing is left behind.
    """
    path = path.resolve()
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not can_replace(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise CalibrationFileError(f"{path}: cannot write it: {error.strerror}") from error


def write_atomic(path: Path, text: str) -> None:
    """Write a text file: beside it under another name, synced to disk, then renamed over it.

    A file that is replaced keeps its permissions; a link keeps pointing where it points. A device
    or a pipe is written into.
    """
    path = path.resolve()
    temporary = None
    try:
        if not can_replace(path):
            path.write_text(text, encoding="utf-8", newline="\n")
            return
        mode = path.stat().st_mode & 0o7777 if path.exists() else 0o666 & ~_umask()
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, mode)
        os.replace(temporary, path)
    except OSError as error:
        raise CalibrationFileError(f"{path}: cannot write it: {error.strerror}") from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    # The rename itself is on disk only once the folder is; Windows has no such call.
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _no_constant(name: str) -> NoReturn:
    raise CalibrationFileError(f"it holds {name}, which is no number: the file is damaged")


def _compact_rows(text: str) -> str:
    """Put the innermost lists of numbers on one line each: a covariance of p rows, not p² lines."""
    return re.sub(
        r"\[\n\s*([-+0-9.eE,\s]+?)\n\s*\]",  # a raw line break never stands inside a JSON string
        lambda match: "[" + re.sub(r"\s+", " ", match.group(1)) + "]",
        text,
    )


def describe_input(path: str | Path) -> InputFile:
    """Return a file's name and the SHA-256 of its bytes, for the provenance."""
    path = Path(path)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
    return InputFile(name_of(path), digest.hexdigest())


def name_of(path: Path) -> str:
    """Return a file's name as text that can be written: what is no UTF-8 in it is replaced."""
    return path.name.encode("utf-8", "replace").decode("utf-8")
