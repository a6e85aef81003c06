"""Serial protocols, bytes to samples, pure: one file each."""

from __future__ import annotations

from functools import cache

from calib.errors import BadFrameError
from calib.registry import discover
from drivers.dialects.base import Dialect

ENOUGH = 0.5
"""A dialect is recognised if its frames make up this fraction of the bytes."""


@cache
def dialects() -> dict[str, Dialect]:
    """Return every dialect of this folder by its name."""
    return discover(__name__, __path__, attribute="DIALECT", kind=Dialect, key="name")  # type: ignore[type-abstract]


def recognise(data: bytes) -> Dialect:
    """Return the dialect that explains most of `data`.

    Raises
    ------
    BadFrameError
        If none explains at least half of it; the message shows the first bytes.
    """
    scores = {name: dialect.recognise(data) for name, dialect in dialects().items()}
    best = max(scores, key=scores.__getitem__)
    if scores[best] >= ENOUGH:
        return dialects()[best]
    raise BadFrameError(
        f"{len(data)} bytes that are no known dialect ({', '.join(dialects())}); they begin with "
        f"{data[:24].hex(' ')}. A wrong baud rate looks like this: try baud=9600, 57600, 115200, "
        "921600; or name the dialect, or the columns of text lines, in the address"
    )
