"""Where an output is written before it stands under its name."""

from __future__ import annotations

import stat
from pathlib import Path


def can_replace(path: Path) -> bool:
    """Return whether a new file may be renamed over this one: it is a regular file, or not there.

    A device or a pipe stays what it is, and is written into.
    """
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return True
