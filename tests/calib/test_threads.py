"""Linear algebra on one thread, where a diagnosis asks for it and nowhere else."""

import numpy as np
import pytest

from calib.threads import libraries, one_thread


def threads():
    return [library.get() for library in libraries()]


@pytest.fixture
def two_threads():
    if not libraries():
        pytest.skip("numpy and scipy use no OpenBLAS here")
    before = threads()
    for library in libraries():
        library.set(2)
    yield
    for library, number in zip(libraries(), before, strict=True):
        library.set(number)


def test_one_thread_inside_and_as_before_outside(two_threads):
    with one_thread():
        assert set(threads()) == {1}
        with one_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {1}
    assert set(threads()) == {2}


def test_threads_come_back_after_an_error(two_threads):
    with pytest.raises(np.linalg.LinAlgError), one_thread():
        np.linalg.cholesky(-np.eye(3))
    assert set(threads()) == {2}


def test_a_decorated_function_runs_on_one_thread(two_threads):
    assert one_thread()(threads)() == [1] * len(libraries())
    assert set(threads()) == {2}
