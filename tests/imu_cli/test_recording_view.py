"""What ends a recording: signals."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

WAITING = """
import sys
from imu_cli.recording_view import stop_on_signals
with stop_on_signals() as stop:
    print("waits", flush=True)
    while not stop.wait(0.0):
        pass
print("ended", flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no signal can be sent to a process")
def test_a_signal_ends_who_waits_for_it_at_every_moment() -> None:
    """Also while the one that waits holds the lock of what it waits for."""
    for n in range(5):
        with subprocess.Popen(
            [sys.executable, "-c", WAITING], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            try:
                assert process.stdout.readline() == "waits\n"
                time.sleep(0.001 * n)
                process.send_signal(signal.SIGINT)
                said, _ = process.communicate(timeout=20)
            finally:
                process.kill()
        assert (said, process.returncode) == ("ended\n", 0)
