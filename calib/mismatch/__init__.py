"""Recording minus simulation: where, what, how much, proven on held-out data.

`diagnose_recording` compares a recording with its own digital twin, `diagnose_against` with the
user's own simulation.
"""

from calib.mismatch.against import diagnose_against
from calib.mismatch.diagnosis import Diagnosis, Finding, Unexplained
from calib.mismatch.engine import diagnose_recording

__all__ = ["Diagnosis", "Finding", "Unexplained", "diagnose_against", "diagnose_recording"]
