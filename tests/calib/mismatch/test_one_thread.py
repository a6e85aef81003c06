"""A diagnosis is no faster on two threads, and far from it."""

from calib.mismatch import diagnose_recording, engine
from calib.threads import libraries

from .bench import GRAVITY, recording


def test_a_diagnosis_works_on_one_thread(monkeypatch):
    before = [library.get() for library in libraries()]
    seen = []

    def noticed(*_):
        seen.extend(library.get() for library in libraries())
        return ()

    monkeypatch.setattr(engine, "look_at_rests", noticed)
    try:
        for library in libraries():
            library.set(2)
        diagnose_recording(recording(), gravity=GRAVITY)
        after = [library.get() for library in libraries()]
    finally:
        for library, number in zip(libraries(), before, strict=True):
            library.set(number)
    assert seen == [1] * len(libraries())
    assert after == [2] * len(libraries())
