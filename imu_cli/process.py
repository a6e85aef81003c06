"""What this process asks of the machine before numpy is loaded: threads, memory and garbage."""

from __future__ import annotations

import gc
import os

GARBAGE = 400_000
"""Objects between two searches for cycles of garbage: looking at all of them takes time."""

LARGE = 2**25 - 2**16
"""Bytes of the largest piece of memory that glibc may keep, once it was given back."""


def prepare() -> None:
    """Set what a diagnosis needs least time with; what the environment says stays as it is."""
    # Our matrices are small: threads would cost more than they bring.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # glibc returns what arrays leave to the system, which clears it before they get it again, but
    # for what is smaller than the largest piece that came back so far.
    bytearray(LARGE)
    # A diagnosis makes tens of thousands of candidates, and no cycle among them is ever left.
    gc.set_threshold(GARBAGE)
