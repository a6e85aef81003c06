"""How well does the diagnosis name what a simulation leaves out, and how often does it cry wolf?

Every case is a 30-pose bench recording of a consumer part with white noise, bias instability,
random walks, tremor of the hand and a temperature that rises. One effect is added, at a size at
which an oracle that knows the term (its shape, and the noise) has a given non-centrality *after*
baseline and attitudes have absorbed what they can. Then the recording alone goes through the
diagnosis.

``--quick`` takes minutes on one core; ``--seeds 20`` is the full table. ``--parts crosstalk`` are
further kinds outside the catalogue: what a channel hears of the motion of other axes; ``--parts
drifting`` clean recordings of parts that drift many times as far as most, ``slow`` clean ones of 10
to 50 samples a second, in fine or coarse counts or in none. With ``--wide`` every recording has
another protocol, another rate and a part of its own. With ``--held`` a hand holds the sensor in its
rests too, and sways: effects are as large as on a table.
"""

from __future__ import annotations

import argparse
import copy
import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from zlib import crc32

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _crosstalk import CROSSTALK
from _outside import OUTSIDE, detectable
from scipy.special import logsumexp

from calib.effects import effects, get_effect
from calib.effects.base import Effect, Term
from calib.mismatch import diagnose_recording
from calib.mismatch.findings.heldout import held_out
from calib.mismatch.hypotheses.factors import LARGE
from calib.mismatch.hypotheses.families import effect_columns, shape_grid
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.coupling import drift_in_contrasts, foretold
from calib.mismatch.noise.noise import Whitener, make_whitener
from calib.mismatch.noise.sensornoise import DRIFT_TIME, LEAN
from calib.mismatch.rows.grid import Grid, make_grid
from calib.mismatch.rows.lapped import lapped
from calib.mismatch.rows.rows import Rows
from calib.mismatch.rows.underway import under_way
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import CLAIM, make_stack
from calib.mismatch.search.search import TIE
from calib.mismatch.twin.residuals import build_rows
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel, Triad
from calib.recording import CHANNELS, Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.statics import find_poses

GRAVITY = 9.80665
RATE = 100.0
GOALS = {100: 0.98, 50: 0.92, 25: 0.60}
DRIFTING = (4.0, 10.0, 30.0)
"""Times the random walk of a consumer part, whose Allan plots rise from two minutes on: from eight
seconds on, from one, and from a tenth."""


SLOW = (10.0, 12.5, 16.0, 20.0, 25.0, 31.25, 50.0)
"""Hz."""

COUNTS = (None, (16384.0, 131.0), (4096.0, 16.4))
"""Per g and per degree per second: none, and those of 16 bits at small and at large ranges."""


@dataclass(frozen=True)
class Case:
    """One run: what is added, at which non-centralities, with which seed."""

    kind: str
    names: tuple[str, ...]
    power: float
    seed: int
    wide: bool = False
    held: bool = False


@dataclass(frozen=True)
class Bench:
    """How a recording is made."""

    motion: Motion
    noise: NoiseModel
    rate: float
    counts: tuple[float, float] | None = None

    def record(self, sensor: SensorModel, seed: int) -> Recording:
        """Return a recording of a sensor, with noise, in whole counts if it has any."""
        rng = np.random.default_rng(seed)
        made = simulate(self.motion, sensor, self.noise, rng=rng, rate=self.rate)
        if self.counts is None:
            return made
        accel, gyro = GRAVITY / self.counts[0], np.radians(1.0) / self.counts[1]
        return replace(
            made, accel=accel * np.rint(made.accel / accel), gyro=gyro * np.rint(made.gyro / gyro)
        )

    def sample_noise(self, channel: str) -> float:
        """Return the white noise of one sample."""
        accel = channel.startswith("accel")
        density = self.noise.accel_noise_density if accel else self.noise.gyro_noise_density
        return density * float(np.sqrt(self.rate / 2))


@dataclass
class Result:
    """What came out of one run."""

    case: Case
    found: list[tuple[str, list[str]]] = field(default_factory=list)
    unexplained: list[tuple[str, tuple[float, float], tuple[str, ...]]] = field(
        default_factory=list
    )
    errors: list[float] = field(default_factory=list)
    gain: float | None = None
    overlap: float = 0.0
    covered: float = 0.0
    seconds: float = 0.0
    known: bool | None = None
    """Whether the evidence would name it, or claim what has no name, if the noise were known."""
    detectable: bool = True
    verdict: str = ""
    shown: bool = True
    """Whether an effect of any size that one would believe shows as much in such a recording."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a few seeds, two sizes")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--effects", nargs="*", help="only these")
    parser.add_argument("--powers", type=float, nargs="*", default=[25, 50, 100, 200])
    parser.add_argument("--parts", nargs="*", default=["single", "clean", "pairs", "outside"])
    parser.add_argument("--wide", action="store_true", help="protocols, rates and parts apart")
    parser.add_argument("--held", action="store_true", help="held in a hand, in rests too")
    parser.add_argument("--verbose", action="store_true")
    args = parser.parse_args()
    if args.held and (args.wide or "slow" in args.parts):
        parser.error("--held goes with the usual protocol")
    seeds, clean, powers = args.seeds, args.clean, args.powers
    if args.quick:
        seeds, clean, powers = 1, 12, [50.0, 100.0]
    seen = range(args.first, args.first + seeds)
    names = args.effects or hidden_effects()
    cases: list[Case] = []
    if "single" in args.parts:
        cases += [Case("single", (n,), p, s) for n in names for p in powers for s in seen]
    if "clean" in args.parts:
        cases += [Case("clean", (), 0.0, 10_000 + args.first + s) for s in range(clean)]
    if "drifting" in args.parts:
        each = range(10_000 + args.first, 10_000 + args.first + clean)
        cases += [Case("drifting", (), times, s) for times in DRIFTING for s in each]
    if "slow" in args.parts:
        cases += [Case("slow", (), 0.0, 10_000 + args.first + s) for s in range(clean)]
    if "pairs" in args.parts:
        rng = np.random.default_rng(7 + args.first)
        pairs = [tuple(rng.choice(names, 2, replace=False)) for _ in range(max(4, 2 * seeds))]
        cases += [Case("pairs", p, 80.0, 20_000 + args.first + i) for i, p in enumerate(pairs)]
    for part, kinds in (("outside", OUTSIDE), ("crosstalk", CROSSTALK)):
        if part in args.parts:
            cases += [
                Case("outside", (n,), 100.0, 30_000 + args.first + s)
                for n in kinds
                for s in range(max(2, seeds))
            ]
    cases = [replace(case, wide=args.wide, held=args.held) for case in cases]
    return report(list(run_all(cases, args.jobs, verbose=args.verbose)))


def run_all(
    cases: list[Case], jobs: int, *, verbose: bool, work: Callable[[Case], Result] | None = None
):
    work = run if work is None else work
    if jobs > 1:
        with ProcessPoolExecutor(jobs) as pool:
            for result in pool.map(work, cases, chunksize=1):
                _say(result, verbose=verbose)
                yield result
        return
    for case in cases:
        result = work(case)
        _say(result, verbose=verbose)
        yield result


def _say(result: Result, *, verbose: bool) -> None:
    if verbose:
        c = result.case
        print(
            f"{c.kind:8s} {'+'.join(c.names):40s} {c.power:5.0f} seed {c.seed:6d} "
            f"{result.seconds:5.1f} s  {result.verdict:17s} {result.found} {result.unexplained}"
            f" z={[round(e, 1) for e in result.errors]} overlap {result.overlap:.2f}"
            f" covered {result.covered:.2f}"
            f" detectable {result.detectable} if the noise were known {result.known}",
            file=sys.stderr,
            flush=True,
        )


def hidden_effects() -> list[str]:
    """Return the effects that a recording shows by itself, in its rests and turns."""
    out = []
    for slug, effect in effects().items():
        if all(p.reference_only for p in effect.parameters):
            continue
        if effect.is_readout and slug != "dropped_samples":
            continue
        if slug == "clock_scale":
            continue
        out.append(slug)
    return out


def run(case: Case) -> Result:
    """Make one recording and diagnose it."""
    # Every effect has a motion, a sensor and a noise of its own, the same at every size.
    rng = np.random.default_rng((case.seed, crc32("".join(case.names).encode())))
    shaken = any("vibration" in n for n in case.names)
    # A fan in the room, or a motor on the bench.
    vibration = float(np.exp(rng.uniform(np.log(0.15), np.log(3.0)))) if shaken else 0.0
    if case.kind == "slow":
        rate, counts = float(rng.choice(SLOW)), COUNTS[rng.integers(len(COUNTS))]
        bench = replace(wide_bench(rng, vibration), rate=rate, counts=counts)
    elif case.wide:
        bench = wide_bench(rng, vibration)
    else:
        again = copy.deepcopy(rng)
        motion = bench_protocol(rng, poses=30, power_on=0.0, vibration=vibration)
        bench = Bench(motion, CONSUMER, RATE)
    if case.kind == "drifting":
        bench = replace(bench, noise=walking(bench.noise, case.power))
    model = random_sensor(rng)
    noise_seed = int(rng.integers(1 << 40))
    result = Result(case)
    clean = bench.record(model, noise_seed)
    # The twin counts temperature from its median, and so do the terms: k and q are what they say.
    model = replace(model, reference_temperature=float(np.median(clean.temperature)))
    truth: dict[str, Term] = {}
    disturbed = None
    interval = None
    if case.names:
        rows, whitener, problem = oracle(clean, bench)
        for name in case.names:
            if case.kind == "outside":
                made = (OUTSIDE | CROSSTALK)[name](rows, rng)
                interval = made.interval
                column = rows.column(made.add(rows.state))
                size = float(np.sqrt(case.power / np.square(whitener.project(column)).sum()))
                extra = made.add(bench.motion.state(clean.time))
                result.detectable = detectable(made, rows, whitener, column, size)
                disturbed = {
                    c: v * (bench.sample_noise(c) if made.fast else size) for c, v in extra.items()
                }
            else:
                term = sized_term(
                    get_effect(name),
                    rows,
                    whitener,
                    case.power,
                    rng,
                    physical=case.wide,
                    change=lambda term: whole_change(term, model, bench, clean, problem),
                )
                if term is None:
                    return replace(result, shown=False)
                truth[name] = term
    model = replace(model, terms=tuple(truth.values()))
    if case.held:
        # The same poses and turns, in a hand that sways by tenths of a degree.
        sway, tremor = np.exp(rng.uniform(np.log(0.3), np.log(1.5))), rng.uniform(0.05, 0.2)
        motion = bench_protocol(
            again, poses=30, power_on=0.0, vibration=vibration, sway=sway, hold_tremor=tremor
        )
        bench = replace(bench, motion=motion)
    recording = bench.record(model, noise_seed) if truth or case.held else clean
    if disturbed:
        accel, gyro = recording.accel.copy(), recording.gyro.copy()
        for channel, values in disturbed.items():
            (accel if channel.startswith("accel") else gyro)[:, CHANNELS.index(channel) % 3] += (
                values
            )
        recording = Recording(
            clean.time, accel, gyro, clean.clock, temperature=clean.temperature, device=clean.device
        )
    start = time.process_time()
    found = diagnose_recording(recording, gravity=GRAVITY)
    result.seconds = time.process_time() - start
    result.verdict = found.verdict
    for item in found.findings:
        if bench.counts and item.effect == "quantization":
            continue
        result.found.append((item.effect, [r.effect for r in item.rivals]))
        if case.kind == "single" and item.effect in truth and item.held_out is not None:
            best = oracle_gain(rows_of(recording), truth[item.effect], noise=bench.noise)
            result.gain = item.held_out.gain / best
        # East and north are known up to heading.
        if item.effect in truth and item.effect != "earth_rate":
            term = truth[item.effect]
            for key, q in item.parameters.items():
                if (q.sigma and key in term.parameters) or (
                    q.sigma and not get_effect(item.effect).shape
                ):
                    result.errors.append((q.value - term.parameters.get(key, 0.0)) / q.sigma)
    if case.kind == "single":
        result.known = named_with_noise_known(rows_of(recording), case.names[0], noise=bench.noise)
    if case.kind == "outside":
        result.known = named_with_noise_known(rows_of(recording), "", noise=bench.noise)
    for left in found.unexplained:
        result.unexplained.append((left.follows, left.intervals[0], left.channels))
        if interval is not None:
            result.overlap = max(result.overlap, overlap(left.intervals[0], interval))
            result.covered = max(result.covered, covered(left.intervals[0], interval))
    return result


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return the intersection of two intervals over their union."""
    common = max(0.0, min(one[1], other[1]) - max(one[0], other[0]))
    return common / (max(one[1], other[1]) - min(one[0], other[0]))


def covered(one: tuple[float, float], true: tuple[float, float]) -> float:
    """Return the share of a true interval that another one covers."""
    common = max(0.0, min(one[1], true[1]) - max(one[0], true[0]))
    return common / (true[1] - true[0])


def wide_bench(rng: np.random.Generator, vibration: float) -> Bench:
    """Return a protocol, a rate and the noise of a part, far from the usual ones in any way.

    White noise, flicker and walk are each up to three times more or less than those of a consumer
    part, and so is the gyroscope's white noise by up to two beside the accelerometer's.
    """

    def times(most: float) -> float:
        return float(np.exp(rng.uniform(-np.log(most), np.log(most))))

    poses, rest = int(rng.integers(14, 60)), 5.0 * times(2.45)
    rate = float(rng.choice([50, 100, 200, 400]))
    white, flicker, walk, gyro = times(3), times(3), times(3), times(2)
    noise = NoiseModel(
        accel_noise_density=white * CONSUMER.accel_noise_density,
        gyro_noise_density=white * gyro * CONSUMER.gyro_noise_density,
        accel_bias_instability=white * flicker * CONSUMER.accel_bias_instability,
        gyro_bias_instability=white * flicker * CONSUMER.gyro_bias_instability,
        accel_random_walk=white * flicker * walk * CONSUMER.accel_random_walk,
        gyro_random_walk=white * flicker * walk * CONSUMER.gyro_random_walk,
        temperature=CONSUMER.temperature,
    )
    motion = bench_protocol(
        rng,
        poses=poses,
        pose_duration=(0.7 * rest, 1.3 * rest),
        turn_duration=(float(rng.uniform(0.5, 1.2)), float(rng.uniform(1.5, 4.0))),
        first_pose=float(rng.uniform(1.0, 10.0)),
        mixed=float(rng.uniform(0.1, 0.8)),
        tremor=times(2),
        warm_up=float(rng.uniform(1.0, 12.0)),
        warm_up_time=float(rng.uniform(60.0, 400.0)),
        power_on=0.0,
        vibration=vibration,
    )
    return Bench(motion, noise, rate if poses * rest * rate < 60_000 else 50.0)


def walking(noise: NoiseModel, times: float) -> NoiseModel:
    """Return the noise of a part whose biases walk so many times as far."""
    return replace(
        noise,
        accel_random_walk=times * noise.accel_random_walk,
        gyro_random_walk=times * noise.gyro_random_walk,
    )


def random_sensor(rng: np.random.Generator) -> SensorModel:
    """Return a consumer part with errors of the paper's model only."""
    return SensorModel(
        Triad(
            rng.normal(0, 0.2, 3), rng.normal(0, 0.01, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(rng.normal(0, 0.01, 3), rng.normal(0, 0.01, 3)),
        reference_temperature=30.0,
    )


def grid_of(recording: Recording) -> Grid:
    """Return the rests and turns of a recording, as a diagnosis has them."""
    poses = find_poses(recording)
    return lapped(make_grid(recording, poses, turns=under_way(recording, poses)), recording)


def oracle(clean: Recording, bench: Bench) -> tuple[Rows, Whitener, SelfProblem]:
    """Return rows of the clean recording, the whitener of its noise, and where the rows come from.

    The state of the rows is the true one: what noise adds to a column shows in no recording.
    """
    grid = grid_of(clean)
    problem = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    rows = problem.rows()
    mean = np.hstack((rows.baseline, rows.nuisance))
    true = bench.motion.state(rows.state.time)
    rows = replace(rows, state=replace(rows.state, force=true.force, rate=true.rate))
    levels = true_levels(rows, bench.noise)
    contrast = contrast_of(rows, levels, reference=False)
    return rows, make_whitener(rows, levels, contrast, mean), problem


def whole_change(
    term: Term, model: SensorModel, bench: Bench, clean: Recording, problem: SelfProblem
) -> np.ndarray:
    """Return what a term does to the rows of a recording without noise: of any size, as it is."""
    poses, quiet = find_poses(clean), replace(bench, noise=NoiseModel())
    turns = under_way(clean, poses)
    recordings = (quiet.record(replace(model, terms=t), 0) for t in ((), (term,)))
    grids = (make_grid(recording, poses, turns=turns) for recording in recordings)
    without, made = (build_rows(g, problem.twin, problem.noise).residual for g in grids)
    return made - without


def rows_of(recording: Recording) -> Rows:
    """Return the rows of a recording by itself."""
    grid = grid_of(recording)
    return SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).rows()


def named_with_noise_known(
    rows: Rows,
    name: str,
    *,
    noise: NoiseModel = CONSUMER,
    skip: tuple[str, ...] = (),
    reference: bool = False,
) -> bool:
    """Return whether the evidence would claim and name an effect if the noise were known.

    The same candidates and weights, with the levels of drift that the recording was made with: what
    is named so and not otherwise is lost to not knowing them. Without a name: whether anything is
    claimed.
    """
    stack = make_stack(rows, skip=skip, reference=reference)
    levels = true_levels(rows, noise)
    contrast = contrast_of(rows, levels, reference=reference)
    whitener = make_whitener(rows, levels, contrast, fitted(rows, []))
    evidence = stack.log_bayes_factors(whitener, whitener.project(rows.residual))
    evidence += stack.weight
    total = logsumexp(evidence)
    scored = zip(evidence, stack, strict=True)
    own = logsumexp([e for e, c in scored if name in ("", c.name)])
    return bool(total > np.log(CLAIM) and own - total > np.log(TIE))


def contrast_of(
    rows: Rows, levels: np.ndarray, *, reference: bool, apart: bool = False
) -> np.ndarray:
    """Return the variance that contrasts have for one who knows how far biases drift.

    White noise, and drift within the rest: what means do not foretell of it, unless contrasts are
    taken ``apart`` from these. Beside a reference what shakes in single windows is noise, too.
    """
    if reference:
        return contrast_variance(rows)
    variance = rows.white_diagonal + levels @ drift_in_contrasts(rows)
    for known in () if apart else foretold(rows, levels):
        variance[known.contrast] = known.variance
    return variance


def oracle_gain(
    rows: Rows, term: Term, *, noise: NoiseModel = CONSUMER, reference: bool = False
) -> float:
    """Return the held-out gain of one who knows the term but for its size, and the noise."""
    effect = get_effect(term.effect)
    shape = {i.name: term.parameters[i.name] for i in effect.shape if i.name in term.parameters}
    columns = effect_columns(effect, rows, shape, reference=reference)
    channels = {p.name: p.channels for p in effect.parameters}
    typical = {p.name: p.typical for p in effect.parameters}
    size = {name: term.parameters.get(name, 0.0) / typical[name] for name in columns}
    column = sum(v * columns[n] for n, v in size.items())
    levels = true_levels(rows, noise)
    return held_out(
        rows,
        np.hstack((rows.baseline, rows.nuisance)),
        column[:, None],
        rows.residual,
        levels=levels,
        contrast=contrast_of(rows, levels, reference=reference, apart=True),
        channels=tuple(c for n, v in size.items() if v for c in channels[n]),
    ).gain


def true_levels(rows: Rows, noise: NoiseModel) -> np.ndarray:
    """Return the levels of drift of a noise model; the closures have no errors of their own."""
    known = {
        "accel": (noise.accel_bias_instability, noise.accel_random_walk),
        "gyro": (noise.gyro_bias_instability, noise.gyro_random_walk),
    }
    out = []
    for component in rows.components:
        triad, _, label = component.name.partition(".")
        flicker, walk = known.get(triad, (0.0, 0.0))
        size = {"flicker": flicker, "walk": walk * np.sqrt(DRIFT_TIME)}.get(label[2:], 0.0)
        least = 1.0 if component.group == LEAN and rows.lean and rows.lean.told else 1e-6
        out.append(max(size**2, least * component.expected))
    return np.array(out)


def sized_term(
    effect: Effect,
    rows: Rows,
    whitener: Whitener,
    power: float,
    rng: np.random.Generator,
    *,
    reference: bool = False,
    physical: bool = False,
    change: Callable[[Term], np.ndarray] | None = None,
) -> Term | None:
    """Return the effect with random signs and axes, sized to the oracle's non-centrality.

    What is there or not has no small size that is to scale: ``change`` is what it does to the rows,
    where these are not linear in the signals. With ``physical`` no parameter is larger than anyone
    would believe; None if the rows show none of them then (what an axis has that never turns).
    """
    shape: dict[str, float] = {}
    optional = [s for s in effect.shape if s.optional and s.spacing != "integer"]
    chosen = optional[int(rng.integers(len(optional)))] if optional else None
    for item in effect.shape:
        if item.optional and item is not chosen and item.spacing != "integer":
            continue
        grid = shape_grid(item, rows, 7)
        if item.spacing == "integer":
            shape[item.name] = float(rng.choice(grid))
        elif item.spacing == "log":
            shape[item.name] = float(np.exp(rng.uniform(*np.log([grid[1], grid[4]]))))
        else:
            # A moment in a turn: between rests.
            turns = rows.interval[~rows.is_rest]
            k = int(rng.integers(len(turns) // 5, 4 * len(turns) // 5))
            shape[item.name] = float(turns[k].mean())
    columns = effect.columns(rows.state, shape)
    names = [
        p.name
        for p in effect.parameters
        if p.name in columns and (reference or not p.reference_only)
    ]
    typical = {p.name: p.typical for p in effect.parameters}
    if physical:
        far = effect.limits([p.name for p in effect.parameters])[1]
        most = {
            p.name: min(LARGE * p.typical, own)
            for p, own in zip(effect.parameters, far, strict=True)
        }
        largest = {n: most[n] * rows.column(columns[n]) for n in names}
        names = [n for n in names if np.square(whitener.project(largest[n])).sum() >= power]
        if not names:
            return None
    if chosen is not None:
        names = names[:1] if len(columns) == 1 else names
    single = rng.random() < 0.5
    # What refines other parameters (a cube of temperature) comes with them only.
    alone = [p.name for p in effect.parameters if p.name in names and not p.refining]
    used = [str(rng.choice(alone))] if single else names
    weights = {n: typical[n] * rng.normal() for n in used}
    if single:
        weights = {n: typical[n] * float(rng.choice([-1.0, 1.0])) for n in used}
    # Of what is never negative (no filter sharpens) there is no such case.
    never = {p.name for p in effect.parameters if p.least is not None and p.least >= 0.0}
    weights = {n: abs(w) if n in never else w for n, w in weights.items()}
    total = sum(w * rows.column(columns[n]) for n, w in weights.items())
    scale = float(np.sqrt(power / np.square(whitener.project(total)).sum()))
    if any(p.unit == "samples" for p in effect.parameters):
        # Samples are lost whole: the nearest number to the power that was asked for.
        weights = {
            n: float(np.sign(w)) * max(1.0, round(abs(scale * w))) for n, w in weights.items()
        }
        scale = 1.0
    if chosen is not None:
        # A presence is 1: its size is the shape itself, and power falls with it.
        used = list(columns)
        low, high = np.log([chosen.low, 10 * chosen.high])
        for _ in range(16):
            shape[chosen.name] = float(np.exp(0.5 * (low + high)))
            there = Term(effect.slug, {**dict.fromkeys(used, 1.0), **shape})
            if change is None:
                found = effect.columns(rows.state, shape)
                made = sum(map(rows.column, found.values()))
            else:
                made = change(there)
            strong = np.square(whitener.project(made)).sum()
            low, high = (0.5 * (low + high), high) if strong > power else (low, 0.5 * (low + high))
        return there
    return Term(effect.slug, {**{n: scale * w for n, w in weights.items()}, **shape})


def report(results: list[Result]) -> int:
    """Print the tables; return 1 if a stated goal is missed."""
    missed = 0
    if hidden := sum(not r.shown for r in results):
        print(f"{hidden} of {len(results)} are not of a size that shows as much, and left out\n")
    results = [r for r in results if r.shown]
    single = [r for r in results if r.case.kind == "single"]
    if single:
        ideal = any(r.known is not None for r in single)
        head = "| non-centrality | cases | found | right name | or among rivals | false name |"
        print(head + " more than one cause said |" + " named if the noise were known |" * ideal)
        print("|---|---|---|---|---|---|---|" + "---|" * ideal)
        for power in sorted({r.case.power for r in single}):
            part = [r for r in single if r.case.power == power]
            n = len(part)
            some = sum(bool(r.found or r.unexplained) for r in part)
            right = sum(any(f == r.case.names[0] for f, _ in r.found) for r in part)
            among = sum(
                any(f == r.case.names[0] or r.case.names[0] in rivals for f, rivals in r.found)
                for r in part
            )
            false = sum(
                any(f != r.case.names[0] and r.case.names[0] not in rv for f, rv in r.found)
                for r in part
            )
            more = sum(len(r.found) + len(r.unexplained) > 1 for r in part)
            shares = f"{some / n:.0%} | {right / n:.0%} | {among / n:.0%} | {false / n:.1%}"
            shares += f" | {more / n:.1%}"
            if ideal:
                judged = [r.known for r in part if r.known is not None]
                shares += f" | {np.mean(judged):.0%}"
            print(f"| {power:.0f} | {n} | {shares} |")
            if among / n < GOALS.get(int(power), 0.0):
                missed += 1
        errors = np.concatenate([r.errors for r in single if r.errors] or [np.zeros(0)])
        if len(errors):
            inside = float(np.mean(np.abs(errors) < 3))
            print(f"\nparameters within 3 standard errors: {inside:.1%} of {len(errors)}")
            missed += inside < 0.99
        gains = [r.gain for r in single if r.gain is not None]
        if gains:
            low, middle, high = np.quantile(gains, [0.1, 0.5, 0.9])
            print(
                f"held-out gain (log-likelihood) over the oracle's, of {len(gains)} named: "
                f"median {middle:.2f}, 10 % {low:.2f}, 90 % {high:.2f}"
            )
        worst = Counter(
            r.case.names[0]
            for r in single
            if not any(f == r.case.names[0] or r.case.names[0] in rv for f, rv in r.found)
        )
        print("not named:", dict(worst.most_common(12)))
    clean = [r for r in results if r.case.kind == "clean"]
    if clean:
        false = sum(bool(r.found or r.unexplained) for r in clean)
        print(f"\nclean recordings: {false} of {len(clean)} with anything found")
        missed += false / len(clean) > 0.005
    slow = [r for r in results if r.case.kind == "slow"]
    if slow:
        named = sum(bool(r.found) for r in slow)
        some = sum(bool(r.found or r.unexplained) for r in slow)
        print(f"\nslow clean recordings: {named} of {len(slow)} with a name, {some} with anything")
    drifting = [r for r in results if r.case.kind == "drifting"]
    if drifting:
        print("\n| random walk, times | clean recordings | a name found | anything found |")
        print("|---|---|---|---|")
        for times in sorted({r.case.power for r in drifting}):
            part = [r for r in drifting if r.case.power == times]
            named = sum(bool(r.found) for r in part)
            some = sum(bool(r.found or r.unexplained) for r in part)
            print(f"| {times:g} | {len(part)} | {named} | {some} |")
    pairs = [r for r in results if r.case.kind == "pairs"]
    if pairs:
        hits = Counter(
            sum(any(n == f or n in rv for f, rv in r.found) for n in r.case.names) for r in pairs
        )
        print(f"\npairs at 80 each: both {hits[2]}, one {hits[1]}, none {hits[0]} of {len(pairs)}")
    outside = [r for r in results if r.case.kind == "outside"]
    if outside:
        print(
            "\n| outside the catalogue | cases | detectable | half of it covered, of those | "
            "and half of both | given a name |"
        )
        print("|---|---|---|---|---|---|")
        for kind in [*dict.fromkeys(r.case.names[0] for r in outside), ""]:
            part = [r for r in outside if kind in ("", r.case.names[0])]
            able = [r for r in part if r.detectable]
            half = sum(r.covered >= 0.5 for r in able)
            placed = sum(r.overlap >= 0.5 for r in able)
            named = sum(bool(r.found) for r in part)
            print(f"| {kind or 'all'} | {len(part)} | {len(able)} | {half} | {placed} | {named} |")
        lost = sum(not (r.found or r.unexplained) for r in able)
        known = sum(bool(r.known) and not (r.found or r.unexplained) for r in able)
        also = sum(r.overlap >= 0.5 for r in outside) - placed
        print(
            f"\nof {len(able)} detectable ones nothing was said of {lost}; of {known} of these it "
            f"would be if the noise were known; {also} more were placed"
        )
        missed += named / len(outside) > 0.05
        missed += placed / max(len(able), 1) < 0.9
    seconds = [r.seconds for r in results]
    print(f"\nCPU per diagnosis: median {np.median(seconds):.1f} s, most {max(seconds):.1f} s")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
