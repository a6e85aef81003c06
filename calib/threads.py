"""Linear algebra on one thread.

Matrices of a few hundred rows are too small to share: OpenBLAS, which numpy and scipy come with,
then has its threads wait for each other in loops that cost twenty times the work, and more where
other processes want the same cores. The environment variable ``OPENBLAS_NUM_THREADS`` says so to a
process before it imports numpy; this says so to whoever has imported it already.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import CDLL
from functools import cache
from importlib import import_module
from typing import NamedTuple

_LINKED = ("numpy.linalg._umath_linalg", "scipy.linalg._fblas")
"""What is linked with the libraries that numpy and scipy use: they may be two."""

_NAMES = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)


class Library(NamedTuple):
    """How a library is asked for its number of threads, and told."""

    get: Callable[[], int]
    set: Callable[[int], object]


@contextmanager
def one_thread() -> Iterator[None]:
    """Have OpenBLAS work on one thread, for the whole process; a library of another kind stays."""
    before = [(library, library.get()) for library in libraries()]
    for library, _ in before:
        library.set(1)
    try:
        yield
    finally:
        for library, threads in before:
            library.set(threads)


@cache
def libraries() -> tuple[Library, ...]:
    """Return the OpenBLAS that numpy and scipy use, as far as they are found."""
    found = []
    for module in _LINKED:
        try:
            linked = CDLL(import_module(module).__file__)
        except (ImportError, OSError):
            continue
        for name in _NAMES:
            if hasattr(linked, name.format("get")):
                get, set_ = (getattr(linked, name.format(verb)) for verb in ("get", "set"))
                found.append(Library(get, set_))
    return tuple(found)
