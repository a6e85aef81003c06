"""Recording minus simulation: where, what, how much, proven on held-out data.

`diagnose_recording` compares a recording with its own digital twin, `diagnose_against` with the
user's own simulation, `diagnose_reference` with motion capture, a table or another IMU.
`thin` reads a recording of any length batch by batch, `diagnose_thinned` diagnoses what it leaves.
"""

from calib.mismatch.against import diagnose_against
from calib.mismatch.diagnosis import Diagnosis, Finding, Unexplained
from calib.mismatch.engine import diagnose_recording, diagnose_thinned
from calib.mismatch.referencemode import ReferenceMotion, diagnose_reference
from calib.mismatch.thin import Thinned, thin

__all__ = [
    "Diagnosis",
    "Finding",
    "ReferenceMotion",
    "Thinned",
    "Unexplained",
    "diagnose_against",
    "diagnose_recording",
    "diagnose_reference",
    "diagnose_thinned",
    "thin",
]
