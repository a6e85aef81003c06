"""Recording minus simulation: where, what, how much, proven on held-out data.

`diagnose_recording` compares a recording with its own digital twin, `diagnose_against` with the
user's own simulation, `diagnose_reference` with motion capture, a table or another IMU.
`thin` reads a recording of any length batch by batch, `diagnose_thinned` diagnoses what it leaves.

Each package imports from those before it in this list, and from none after it:

- `rows`: the grid of a recording, the closures of its turns, residuals as rows;
- `noise`: white noise, drift of biases, the closures' own errors;
- `twin`: attitudes and a sensor model that reproduce the recording;
- `findings`: what a diagnosis says, and its proof on held-out data;
- `hypotheses`: the catalogue and its rivals, as columns with prior weights;
- `search`: which explanation is best, fitted jointly with all others, and in words;
- `samples`: what shows in samples and not in means: lost, clipped, coarse, lines, pulses;
- `reference`: a recording beside a simulation, motion capture, a table, another IMU.
"""

from calib.mismatch.engine import diagnose_recording, diagnose_thinned
from calib.mismatch.findings.diagnosis import Diagnosis, Finding, Unexplained
from calib.mismatch.reference.against import diagnose_against
from calib.mismatch.reference.referencemode import ReferenceMotion, diagnose_reference
from calib.mismatch.samples.thin import Thinned, thin

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
