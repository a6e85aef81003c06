"""How well does the diagnosis name what a simulation or a reference does not have?

As `concealed`, against a truth: the user's own simulation of the motion (a perfect sensor without
noise, or one that is ``noisy`` and has errors of its own), motion capture (0.2 mm and 0.1 degrees
of noise, a tenth of a second lost), another IMU on the same body (as noisy, mounted at an angle),
or the commanded profile of a rate table with the sensor off its centre. Rates are drawn from
`RATES` and are seldom alike; the clocks start apart, and the truth begins or ends before the
recording or after it. Each effect has the asked non-centrality after baseline and alignment have
absorbed theirs, beside the noise and the drift of both. So have disturbances that no catalogue has
(``--parts outside``), which are those of `concealed`. With ``--wide`` protocols, rates, the
sensor's noise and that of the truth are far apart, too.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from zlib import crc32

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _outside import OUTSIDE, detectable
from concealed import (
    GRAVITY,
    Bench,
    Case,
    Result,
    contrast_of,
    covered,
    hidden_effects,
    named_with_noise_known,
    oracle_gain,
    overlap,
    random_sensor,
    report,
    run_all,
    sized_term,
    true_levels,
    wide_bench,
)

from calib.effects import get_effect
from calib.effects.base import Term
from calib.effects.observed import TURNING
from calib.mismatch import Diagnosis, ReferenceMotion, diagnose_against, diagnose_reference
from calib.mismatch.hypotheses.families import effect_columns
from calib.mismatch.noise.noise import make_whitener
from calib.mismatch.reference.against import compare_simulation
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.referencemode import compare_reference
from calib.mismatch.rows.rows import Rows
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import CHANNELS, Recording
from calib.rotation import mat_from_quat, mat_from_rotvec, quat_from_rotvec, quat_multiply
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Kinematics, Motion, Path, Segment
from calib.simulation.motions import FACES
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.simulation.turntable import turntable
from calib.statics import find_poses

RATES = {
    "recording": (50.0, 100.0),
    "simulation": (40.0, 80.0, 200.0),
    "noisy": (50.0, 80.0, 200.0),
    "capture": (60.0, 100.0, 120.0, 200.0),
    "imu": (50.0, 64.0, 100.0, 200.0),
    "profile": (20.0, 50.0, 100.0),
}
"""Hz."""

OUTSIDE_ONLY = ("clock_scale", "reference_misalignment", "accel_lever_arm", "time_offset")
WITH_ORIENTATION = ("reference_tilt", "earth_rate", "gravity_magnitude")
CAPTURED = ("reference_smoothing",)
DELAYING = ("time_offset", "clock_scale", "bandwidth", "inter_axis_skew")
"""What shifts signals in time, and with them the offset of the clocks that fits best."""

VIBRATION = 10.0
"""m/s² rms, about 1 g: where data sheets state what vibration does to a mean. Shaken by less, what
a noisy reference shows is beyond what is physical."""

ALIGNED = ("clock_scale", "reference_misalignment")
"""What is fitted whatever is found, and competes with nothing."""

MODES = ("simulation", "noisy", "capture", "imu", "profile")
SIMULATED = ("simulation", "noisy")
PARTS = ("single", "clean", "outside")
OUTSIDE_POWER = 100.0
"""Non-centrality of a disturbance."""

MOUNTING = np.array([0.03, -0.02, 0.6])
ARM = (0.08, 0.0, 0.02)
"""From where a table's axes meet to the sensor, m."""

MARKERS = (2e-4, float(np.radians(0.1)))
"""Noise of a sample of motion capture: of the place in m, and of the angles in rad."""

APART = 3.0
"""Times more or less that it is with ``--wide``."""


Truth = Recording | ReferenceMotion


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--modes", nargs="*", default=MODES, choices=MODES)
    parser.add_argument("--parts", nargs="*", default=PARTS, choices=PARTS)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--effects", nargs="*", help="only these")
    parser.add_argument("--powers", type=float, nargs="*", default=[25, 50, 100, 200])
    parser.add_argument("--wide", action="store_true", help="protocols, rates and parts apart")
    parser.add_argument("--verbose", action="store_true")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    missed = 0
    for mode in args.modes:
        names = args.effects if args.effects is not None else effects_of(mode)
        cases: list[Case] = []
        if "single" in args.parts:
            cases += [Case(mode, (n,), p, s) for n in names for p in args.powers for s in seeds]
        if "clean" in args.parts:
            cases += [Case(mode, (), 0.0, 10_000 + args.first + s) for s in range(args.clean)]
        if "outside" in args.parts:
            cases += [Case(mode, (k,), OUTSIDE_POWER, 30_000 + s) for k in OUTSIDE for s in seeds]
        cases = [replace(case, wide=args.wide) for case in cases]
        print(f"\n## {mode}\n", flush=True)
        results = list(run_all(cases, args.jobs, verbose=args.verbose, work=run))
        unseen = sorted({n for r in results for n in r.case.names if not r.verdict})
        results = [r for r in results if r.verdict]
        named = [replace(r, case=replace(r.case, kind=part_of(r.case))) for r in results]
        missed += report(named)
        if unseen:
            print("not shown by some of the motions:", ", ".join(unseen))
    return int(missed > 0)


def part_of(case: Case) -> str:
    """Return which of `PARTS` a case belongs to."""
    if not case.names:
        return "clean"
    return "outside" if case.names[0] in OUTSIDE else "single"


def effects_of(mode: str) -> list[str]:
    """Return the effects that a truth shows: those of a recording alone, and its own."""
    more = (*OUTSIDE_ONLY[: 1 if mode in SIMULATED else 3], "accel_lever_arm")
    if mode in ("capture", "profile"):
        more += WITH_ORIENTATION
    if mode == "capture":
        more += CAPTURED
    hidden = [n for n in hidden_effects() if n not in WITH_ORIENTATION]
    if mode in ("noisy", "capture", "imu"):
        hidden.remove("bandwidth")
    return list(dict.fromkeys((*hidden, *more)))


def run(case: Case) -> Result:
    """Make one recording and its truth, and diagnose; no verdict where nothing shows the effect."""
    # Each effect has motions and noise of its own: what is unlucky in one is not so in all.
    rng = np.random.default_rng((case.seed, crc32("".join(case.names).encode())))
    bench = make_bench(case, rng)
    model = random_sensor(rng)
    noise_seed = int(rng.integers(1 << 40))
    truth, expected = make_truth(case, bench, rng)
    result = Result(case)
    recording = bench.record(model, noise_seed)
    # The diagnosis counts temperature from its median, and so do the terms: k and q are what it
    # says they are.
    model = replace(model, reference_temperature=float(np.median(recording.temperature)))
    term, interval = None, None
    if part_of(case) == "outside":
        made = disturbed(case, recording, bench, truth, expected, rng)
        if made is None:
            return result
        recording, interval, result.detectable = made
    elif case.names:
        term = sized(case, recording, bench, truth, expected, rng)
        if term is None:
            return result
        recording = bench.record(replace(model, terms=(term,)), noise_seed)
    start = time.process_time()
    found = diagnosed(case.kind, recording, truth)
    gain = None
    result.seconds = time.process_time() - start
    result.verdict = found.verdict
    for item in found.findings:
        mine = term is not None and item.effect == term.effect
        # A delay of one triad against the other is no alignment.
        aligned = {k: expected.get(item.effect, {}).get(k) for k in item.parameters}
        aligns = any(v is not None for v in aligned.values())
        if mine and item.effect == "time_offset":
            mine = "gyro_delay" in item.parameters
        known = {k: v for k, v in aligned.items() if v is not None}
        if mine and term is not None:
            for name, value in term.parameters.items():
                known[name] = known.get(name, 0.0) + value
        if mine or not aligns:
            result.found.append((item.effect, [r.effect for r in item.rivals]))
        if mine and item.held_out is not None:
            gain = item.held_out.gain
        if term is not None and term.effect in DELAYING and not mine:
            # The delay between the clocks is then another one, at another moment.
            continue
        for key, q in item.parameters.items():
            shapeless = not get_effect(item.effect).shape
            if q.sigma and known and (key in known or shapeless):
                result.errors.append((q.value - known.get(key, 0.0)) / q.sigma)
    for left in found.unexplained:
        result.unexplained.append((left.follows, left.intervals[0], left.channels))
        if interval is not None:
            result.overlap = max(result.overlap, overlap(left.intervals[0], interval))
            result.covered = max(result.covered, covered(left.intervals[0], interval))
    if interval is not None or (term is not None and term.effect not in ALIGNED):
        own = "" if term is None else term.effect
        problem, skip = compared(case.kind, recording, truth)
        rows = with_setup(problem.rows(), expected, own)
        noise = noise_of_both(case.kind, bench)
        result.known = named_with_noise_known(rows, own, noise=noise, skip=skip, reference=True)
        if gain is not None and term is not None:
            result.gain = gain / oracle_gain(rows, term, noise=noise, reference=True)
    return result


def disturbed(
    case: Case,
    clean: Recording,
    bench: Bench,
    truth: Truth,
    expected: Mapping[str, object],
    rng: np.random.Generator,
) -> tuple[Recording, tuple[float, float], bool] | None:
    """Return a recording with a disturbance of the case's size, its window, and who could see it.

    That is one who knows the kind, the channel, the window and the noise. None if it would have to
    be as large as all that its channel shows.
    """
    rows = with_setup(compared(case.kind, clean, truth)[0].rows(), expected, "")
    levels = true_levels(rows, noise_of_both(case.kind, bench))
    contrast = contrast_of(rows, levels, reference=True)
    whitener = make_whitener(rows, levels, contrast, np.hstack((rows.baseline, rows.nuisance)))
    # A simulation says nothing of headings, which a field of the room follows.
    heading = bench.motion.state(rows.state.time).mat_ns
    rows = replace(rows, state=replace(rows.state, mat_ns=heading))
    made = OUTSIDE[case.names[0]](rows, rng)
    column = rows.column(made.add(rows.state))
    size = float(np.sqrt(case.power / np.square(whitener.project(column)).sum()))
    values = np.hstack((clean.accel, clean.gyro))
    for channel, extra in made.add(bench.motion.state(clean.time)).items():
        own = values[:, CHANNELS.index(channel)]
        extra *= bench.sample_noise(channel) if made.fast else size
        if np.abs(extra).max() > np.ptp(own):
            return None
        own += extra
    seen = detectable(made, rows, whitener, column, size)
    return replace(clean, accel=values[:, :3], gyro=values[:, 3:]), made.interval, seen


def make_bench(case: Case, rng: np.random.Generator) -> Bench:
    """Return what both see, a sensor handled on a bench or one on a table, and what records it."""
    on_table = case.kind == "profile"
    # Of what an effect leaves alone every other one is shaken too.
    shaken = any("vibration" in n for n in case.names) or (not case.names and case.seed % 2 == 1)
    vibration = VIBRATION * rng.uniform(0.5, 1.5) if shaken and not on_table else 0.0
    if case.wide:
        bench = wide_bench(rng, vibration)
        return replace(bench, motion=make_table(rng)) if on_table else bench
    if on_table:
        motion = make_table(rng)
    else:
        motion = bench_protocol(
            rng,
            poses=20,
            first_pose=3.0,
            pose_duration=(2.0, 4.0),
            power_on=0.0,
            tremor=0.3,
            vibration=vibration,
        )
    return Bench(motion, CONSUMER, float(rng.choice(RATES["recording"])))


def make_table(rng: np.random.Generator) -> Motion:
    """Return a table that spins both ways, the sensor off its centre."""
    rates = np.radians(rng.choice([50.0, 100.0, 200.0, 300.0], 4) * [1, -1, 1, -1])
    # One axis; or a second one that tilts the sensor to its other faces between the spins.
    faces = ["+z"] if rng.random() < 0.5 else list(rng.permutation(list(FACES)))
    rates = rates if len(faces) == 1 else rates[:2]
    spin = rng.uniform(6.0, 12.0) / np.sqrt(len(faces))
    table = turntable(rates.tolist(), faces=faces, offset=(0.0, 0.0, 0.0), spin=spin)
    table = off_centre(table, np.array(ARM))
    # What settles does so after a spin as after a turn by hand.
    at = np.arange(0.0, table.duration, 0.005)
    speed = np.linalg.norm(table.kinematics(at)[0].rate, axis=1)
    turns = at[np.flatnonzero(np.diff(speed > TURNING))].reshape(-1, 2)
    table = replace(table, segments=tuple(Segment("turn", a, b) for a, b in turns.tolist()))
    return replace(table, temperature=lambda t: 28.0 + 6.0 * (1 - np.exp(-t / 180.0)))


def off_centre(motion: Motion, arm: np.ndarray) -> Motion:
    """Return the motion of a sensor that is off the point where a table's axes meet."""

    def kinematics(time: np.ndarray) -> Kinematics:
        turning, _ = motion.kinematics(time)
        mat = mat_from_quat(turning.quat)
        velocity = np.cross(turning.rate, arm)
        acceleration = np.cross(turning.rate, velocity) + np.cross(turning.rate_dot, arm)
        in_room = [np.einsum("nij,nj->ni", mat, v) for v in (velocity, acceleration)]
        return Kinematics(turning, Path(mat @ arm, *in_room))

    return replace(motion, kinematics=kinematics)


def make_truth(
    case: Case, bench: Bench, rng: np.random.Generator
) -> tuple[Truth, dict[str, dict[str, float]]]:
    """Return a truth, and the alignment that a diagnosis should report."""
    mode, motion = case.kind, bench.motion
    rate, start = float(rng.choice(RATES[mode])), float(rng.uniform(-100.0, 100.0))
    early, late = rng.uniform(0.0, 2.5, 2)
    at = np.arange(early, motion.duration - late, 1.0 / rate)
    offset = {"time_offset": {"delay": -start}}
    if mode in (*SIMULATED, "imu"):
        sampling = Sampling(clock_offset=start)
        noise = NoiseModel() if mode == "simulation" else bench.noise
        sensor = random_sensor(rng) if mode == "noisy" else SensorModel()
        other = simulate(motion, sensor, noise, rng=rng, time=at, sampling=sampling)
        if mode in SIMULATED:
            return other, {}
        mat = mat_from_rotvec(MOUNTING)
        turned = replace(other, accel=other.accel @ mat, gyro=other.gyro @ mat)
        turn = dict(zip(("rx", "ry", "rz"), -MOUNTING, strict=True))
        return turned, {**offset, "reference_misalignment": turn}
    turning, path = motion.kinematics(at)
    if mode == "profile":
        # A sensor off the centre has an arm, of which one axis leaves the height open.
        return ReferenceMotion(at + start, turning.quat, fixed=True), {
            **offset,
            "accel_lever_arm": dict(zip(("rx", "ry", "rz"), ARM, strict=True)),
        }
    assert path is not None
    times = np.exp(rng.uniform(-np.log(APART), np.log(APART), 2)) if case.wide else np.ones(2)
    off, turned_by = times * MARKERS
    shake = quat_from_rotvec(rng.normal(0, turned_by, (len(at), 3)))
    quat = quat_multiply(turning.quat, shake)
    position = path.position + rng.normal(0, off, (len(at), 3))
    lost = int(rng.integers(200, len(at) - 200))
    quat[lost : lost + round(0.1 * rate)] = np.nan
    return ReferenceMotion(at + start, quat, position), offset


def compared(
    mode: str, recording: Recording, truth: Truth
) -> tuple[ComparisonProblem, tuple[str, ...]]:
    """Return what the diagnosis compares, and what it does not try.

    An arm of centimetres is in the model from the start: what it makes a sensor feel, the scale
    factors and misalignments act on, and they can absorb what goes with it.
    """
    seen = look_at_samples(recording, find_poses(recording))
    model = None
    if mode == "profile":
        arm = Term("accel_lever_arm", dict(zip(("rx", "ry", "rz"), ARM, strict=True)))
        middle = float(np.median(recording.temperature))
        model = SensorModel(terms=(arm,), reference_temperature=middle)
    if mode in SIMULATED:
        assert isinstance(truth, Recording)
        problem, skip = compare_simulation(recording, truth, seen, gravity=GRAVITY)
    else:
        problem, skip = compare_reference(recording, truth, seen, gravity=GRAVITY, model=model)
    turned = ("reference_misalignment",) if problem.turned else ()
    return problem, (*skip, "clock_scale", *turned)


def noise_of_both(mode: str, bench: Bench) -> NoiseModel:
    """Return what the differences hold: the drift of another sensor adds to the sensor's own."""
    return bench.noise.scaled(np.sqrt(2.0)) if mode in ("noisy", "imu") else bench.noise


def with_setup(rows: Rows, expected: Mapping[str, object], slug: str) -> Rows:
    """Return the rows with what the setup has in any case, besides an effect, as nuisances."""
    aligned = {name.split(".")[0] for name in rows.aligned}
    more = [
        column
        for name in expected
        if name not in aligned and name != slug
        for column in effect_columns(get_effect(name), rows, {}, reference=True).values()
    ]
    return replace(rows, nuisance=np.column_stack((rows.nuisance, *more)))


def sized(
    case: Case,
    clean: Recording,
    bench: Bench,
    truth: Truth,
    expected: Mapping[str, object],
    rng: np.random.Generator,
) -> Term | None:
    """Return the case's effect at its non-centrality after baseline, alignment and arm.

    None if nothing of a physical size shows as much.
    """
    rows = with_setup(compared(case.kind, clean, truth)[0].rows(), expected, case.names[0])
    # An alignment is fitted whatever is added; only of its own kind is it the effect itself.
    own = case.names[0] if case.names[0] != "time_offset" else ""
    kept = [n.split(".")[0] != own for n in rows.aligned]
    kept += [True] * (rows.nuisance.shape[1] - len(kept))
    mean = np.hstack((rows.baseline, rows.nuisance[:, kept]))
    levels = true_levels(rows, noise_of_both(case.kind, bench))
    whitener = make_whitener(rows, levels, contrast_of(rows, levels, reference=True), mean)
    effect = get_effect(case.names[0])
    term = sized_term(
        effect,
        rows,
        whitener,
        case.power,
        rng,
        reference=effect.slug != "time_offset",
        physical=case.wide or case.kind != "simulation",
    )
    # A cut-off beyond the catalogue's: samples as slow as these make more of it than it is.
    inside = term is None or all(
        term.parameters.get(item.name, 0.0) <= item.high
        for item in effect.shape
        if item.optional and item.high is not None
    )
    return term if inside else None


def diagnosed(mode: str, recording: Recording, truth: Truth) -> Diagnosis:
    """Diagnose against a simulation, whose start time is its own, or a reference."""
    if mode in SIMULATED:
        assert isinstance(truth, Recording)
        return diagnose_against(recording, truth, gravity=GRAVITY)
    return diagnose_reference(recording, truth, gravity=GRAVITY)


if __name__ == "__main__":
    sys.exit(main())
