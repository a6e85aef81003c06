"""Does `imu-cal diagnose` name what a generator that shares no code with it has concealed?

Recordings come from `_independent_generator.py` (numpy only) as interchange CSV and are judged by
the command line, in a process of its own: other pose sets, hands, rates, sensors, drift and
temperatures than `concealed.py` has, 3 to 15 minutes long. Effects are 1.5 and 3 times the smallest
size: that at which an oracle has non-centrality 45 (`_independent_oracle.py`), at most
three times what a data sheet calls typical.

``--parts beside`` judges effects, and clean recordings, ``--against`` a simulation of their motion
that is perfect but for its rate, on a clock of its own, ``noisy`` one that is as noisy as the
recording; ``captured`` and ``imu`` do so with ``--reference``: markers that are
seen with noise, or another IMU, turned and some centimetres away.

``--read`` has the logs read badly: ``faster`` than the sensor measures, one triad half as often as
the other, or with a dozen spikes, which then are all that may be unexplained.

A name counts if it is a finding, or a stated rival of one. A name is false if neither it nor its
rivals are in the recording. Failing recordings are kept with ``--keep DIR``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from _independent_generator import (
    AXES,
    EFFECTS,
    G0,
    OUTSIDE,
    READ,
    Errors,
    Motion,
    Setting,
    distort,
    draw_errors,
    draw_setting,
    ideal,
    make_motion,
    noise,
    read_out,
    write_csv,
)
from _independent_generator import (
    PARTS as SENSORS,
)
from _independent_oracle import Oracle
from _independent_reference import REFERENCES

SMALLEST = 45.0
"""Non-centrality of the smallest size."""
CAP = 3.0
"""Times the typical size, at most."""
SHAKEN_CAP = 30.0
"""The same for what only a shaker shows at typical size."""
PARTS = ("single", "clean", "pairs", "outside", "readout", *REFERENCES)
BACK = "off course, and back at once"
"""What is said of spikes, which are there and no other disturbance."""

READOUT = ("saturation", "quantization", "dropped_samples", "unit_error", "axis_error")
STRESS: dict[str, dict[str, object]] = {
    "plain": {},
    "warm_hand": {"temperature": "cycle"},
    "drift_twice": {"drift": 2.0},
    "tremor": {"tremor": 4.0},
    "knock": {"knock": True},
    "held": {"wobble": 3e-4},
    "shaken": {"shaken": True},
    "late": {"late": 5e-4},
    "real": {"misaligned": True, "earth": True},
    "few_samples": {"rate": 25.0, "averaged": False},
    "quiet": {"rate": 50.0, "averaged": False, "part": SENSORS[-1]},
}


@dataclass(frozen=True)
class Case:
    """One recording: what is concealed in it and how large, in smallest sizes."""

    part: str
    names: tuple[str, ...]
    times: float
    seed: int

    @property
    def label(self) -> str:
        return f"{self.part}-{'+'.join(self.names)}-{self.times:g}-{self.seed}"


@dataclass
class Truth:
    """What is in the recording."""

    setting: Setting
    required: tuple[str, ...] = ()
    """Names that must come out."""
    allowed: tuple[str, ...] = ()
    """Names that may come out: they are true as well."""
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)
    powers: dict[str, float] = field(default_factory=dict)
    absorbed: dict[str, float] = field(default_factory=dict)
    interval: tuple[float, float] | None = None
    channels: tuple[int, ...] = ()


@dataclass
class Result:
    """What the command line made of it."""

    case: Case
    truth: Truth
    answer: dict
    seconds: float

    @property
    def findings(self) -> list[tuple[str, list[str]]]:
        return [(f["effect"], [r["effect"] for r in f["rivals"]]) for f in self.answer["findings"]]

    @property
    def present(self) -> set[str]:
        return set(self.truth.required) | set(self.truth.allowed)

    def named(self, name: str) -> bool:
        return any(name == f for f, _ in self.findings)

    def among(self, name: str) -> bool:
        return any(name == f or name in rivals for f, rivals in self.findings)

    @property
    def false(self) -> list[str]:
        return [
            f for f, rv in self.findings if f not in self.present and not self.present & set(rv)
        ]

    @property
    def overlap(self) -> float:
        """Return common over whole length of the truth and the best interval said."""
        best = 0.0
        for item in self.answer["unexplained"] if self.truth.interval else ():
            t0, t1 = self.truth.interval
            for a, b in item["intervals"]:
                a, b = a - self.truth.setting.start, b - self.truth.setting.start
                common = max(0.0, min(b, t1) - max(a, t0))
                best = max(best, common / (max(b, t1) - min(a, t0)))
        return best

    def errors(self) -> Iterator[tuple[str, float]]:
        """Yield parameter errors in their standard errors."""
        for f in self.answer["findings"]:
            truth = self.truth.parameters.get(f["effect"])
            said = f["parameters"]
            # With a square beside it, a coefficient of temperature depends on where T is zero.
            if truth is None or ("kx" in truth and any(n[0] == "q" for n in said)):
                continue
            for name, q in said.items():
                if q["sigma"] and name in truth:
                    value = q["value"] - (self.truth.setting.start if name == "moment" else 0.0)
                    yield f"{f['effect']}.{name}", (value - truth[name]) / q["sigma"]

    @property
    def failed(self) -> bool:
        if self.false:
            return True
        if self.case.part == "outside":
            return self.overlap < 0.5
        if self.case.part == "clean":
            return bool(self.answer["unexplained"]) and self.case.names != ("knock",)
        if not self.case.names:
            return bool(self.answer["unexplained"])
        return not all(self.among(n) for n in self.truth.required)

    def __str__(self) -> str:
        said = "; ".join(f + (f" ({', '.join(rv)})" if rv else "") for f, rv in self.findings)
        left = "; ".join(
            f"{u['follows']} {','.join(u['channels'])} "
            + ",".join(f"{a:.1f}-{b:.1f}" for a, b in u["intervals"][:2])
            for u in self.answer["unexplained"]
        )
        s = self.truth.setting
        powers = ", ".join(f"{k} {v:.0f}" for k, v in self.truth.powers.items())
        worst = max((abs(z) for _, z in self.errors()), default=0.0)
        return (
            f"{'FAIL' if self.failed else 'ok  '} {self.case.label:45s} {self.seconds:4.1f} s "
            f"[{s.part.name} {s.rate:g} Hz, {s.poses} {s.pose_style}, {s.temperature}"
            f"{', misaligned' if s.misaligned else ''}{', earth' if s.earth else ''}] "
            f"({powers}) said: {said or '-'} | unexplained: {left or '-'} | z {worst:.1f}"
            + (f" | at {self.truth.interval}, {self.truth.channels}" if self.truth.interval else "")
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one seed, some of the effects")
    parser.add_argument("--seeds", type=int, default=2, help="recordings per effect and size")
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    alone = [p for p in PARTS if p not in REFERENCES]
    parser.add_argument("--parts", nargs="*", default=alone, choices=PARTS)
    parser.add_argument("--effects", nargs="*", help="only these")
    parser.add_argument("--times", type=float, nargs="*", default=[1.5, 3.0])
    parser.add_argument("--read", choices=READ, default="well", help="how logs were read")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep what fails here")
    parser.add_argument("--verbose", action="store_true")
    args = parser.parse_args()
    results = []
    for case in cases(args):
        result = run(case, args.keep, read=args.read)
        results.append(result)
        if args.verbose or result.failed:
            print(result, file=sys.stderr, flush=True)
    return report(results)


def cases(args: argparse.Namespace) -> Iterator[Case]:
    """Yield what the options ask for."""
    seeds = range(args.first, args.first + (1 if args.quick else args.seeds))
    single = list(EFFECTS)[:: 4 if args.quick else 1]
    chosen = args.effects
    for part in args.parts:
        for seed in seeds:
            if part == "single" or part in REFERENCES:
                for name in chosen or single:
                    if name in EFFECTS:
                        yield from (Case(part, (name,), t, seed) for t in args.times)
                if part in REFERENCES:
                    yield from (Case(part, (), 0.0, 10 * seed + i) for i in range(5))
            elif part == "clean":
                known = [name for name in chosen or STRESS if name in STRESS]
                yield from (Case(part, (name,), 0.0, seed) for name in known)
            elif part == "outside":
                for name in chosen or list(OUTSIDE)[:: 2 if args.quick else 1]:
                    if name in OUTSIDE:
                        yield from (Case(part, (name,), t, seed) for t in args.times)
            elif part == "readout":
                for name in chosen or READOUT:
                    if name in READOUT:
                        yield Case(part, (name,), 1.0, seed)
            elif not chosen:
                rng = np.random.default_rng([seed, 7])
                for _ in range(1 if args.quick else 6):
                    pair = tuple(str(n) for n in rng.choice(list(EFFECTS), 2, replace=False))
                    if _common(pair) is not None:
                        yield Case(part, pair, 2.0, seed)


def _common(names: tuple[str, ...]) -> dict[str, tuple[object, ...]] | None:
    """Return what all of the effects need of a setting, or None if that cannot be."""
    out: dict[str, tuple[object, ...]] = {}
    for name in names:
        for key, values in EFFECTS[name].needs.items() if name in EFFECTS else ():
            both = tuple(v for v in values if v in out.get(key, values))
            if not both:
                return None
            out[key] = both
    return out


def run(case: Case, keep: Path | None, *, read: str = "well") -> Result:
    """Make one recording and let the command line judge it."""
    rng = np.random.default_rng(
        [case.seed, zlib.crc32("+".join((case.part, *case.names)).encode())]
    )
    forced: dict[str, object] = {
        k: v[int(rng.integers(len(v)))] for k, v in (_common(case.names) or {}).items()
    }
    if case.part == "clean":
        forced = dict(STRESS[case.names[0]])
    if forced.get("shaken"):
        forced["averaged"] = False  # a mean over the sample interval would damp the vibration
    if case.part in REFERENCES:
        # What a simulation does not know of: means over a sample's interval, the Earth, a place.
        forced |= {"averaged": False, "earth": False, "gravity": G0}
    setting = draw_setting(rng, **forced)
    motion = make_motion(rng, setting)
    errors = draw_errors(rng, setting)
    truth = Truth(setting)
    output, reading = conceal(rng, case, motion, errors, truth)
    if setting.misaligned:
        # Nothing else is asked of a recording in wrong units or with wrong axes.
        if {"unit_error", "axis_error"} & set(case.names):
            truth.allowed += ("gyro_misalignment",)
        else:
            truth.required += ("gyro_misalignment",)
        off = errors.gyro - np.eye(3)
        truth.parameters["gyro_misalignment"] = {
            f"m{AXES[i]}{AXES[j]}": float(off[i, j]) for i in range(3) for j in range(3) if i != j
        }
    if setting.earth:
        truth.allowed += ("earth_rate",)
        truth.parameters["earth_rate"] = {"up": motion.earth_up}
    if setting.averaged:
        # A mean over the sample interval is a low-pass that both triads share.
        truth.allowed += ("bandwidth",)
    samples = motion.pick(output)
    samples = samples + noise(rng, motion, len(samples))
    time, values, temperature = READ[read](rng, read_out(motion, samples, **reading))
    if read == "faster":
        truth.allowed += ("dropped_samples",)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{case.label}.csv"
        seen = None if setting.temperature == "none" else temperature
        write_csv(path, time, values, seen, rng)
        command = [sys.executable, "-m", "imu_cli", "diagnose", str(path), "--json"]
        if case.part in REFERENCES:
            other = path.with_suffix(".other.csv")
            reference = REFERENCES[case.part](rng, motion, other)
            command += [reference.option, str(other)]
            truth.allowed += reference.allowed
            truth.parameters |= reference.parameters
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        said = subprocess.run(command, capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if said.returncode:
            raise RuntimeError(f"{case.label}: exit {said.returncode}\n{said.stderr}")
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        answer = json.loads(said.stdout)
        if read == "spikes":
            odd = [u for u in answer["unexplained"] if not u["follows"].endswith(BACK)]
            answer["unexplained"] = odd
        result = Result(case, truth, answer, seconds)
        if keep is not None and result.failed:
            keep.mkdir(parents=True, exist_ok=True)
            for file in Path(folder).iterdir():
                (keep / file.name).write_bytes(file.read_bytes())
            (keep / f"{case.label}.txt").write_text(f"{result}\n{truth}\n{said.stdout}")
    return result


def conceal(
    rng: np.random.Generator, case: Case, motion: Motion, errors: Errors, truth: Truth
) -> tuple[np.ndarray, dict]:
    """Return the fine output with the case's effects in it, and options of the read-out."""
    clean = ideal(motion, errors)
    if case.part == "clean" or not case.names:
        return clean, {}
    oracle, setting = Oracle(motion), motion.setting
    if case.part == "readout":
        return clean, spoil(rng, case.names[0], motion, clean, oracle, truth)
    output = clean
    for name in case.names:
        power = SMALLEST * case.times**2
        if case.part == "outside":
            added, truth.interval = OUTSIDE[name](rng, motion)
            truth.channels = tuple(added)
            signal = np.zeros_like(clean)
            for channel, values in added.items():
                signal[:, channel] = values
            if name == "hum":
                # Faster than rests and turns see; as large as the noise of a sample, times 0.7.
                (channel,) = added
                sigma = setting.part.density[channel // 3] * np.sqrt(setting.rate / 2)
                size = 0.7 * case.times * sigma
            else:
                size = float(np.sqrt(power / oracle.power(motion.pick(signal))[0]))
                truth.powers[name] = power
            output = output + size * signal
        else:
            parameters = sized(rng, name, motion, clean, oracle, power)
            changed = distort(motion, output, name, parameters)
            left, raw = oracle.power(motion.pick(distort(motion, clean, name, parameters) - clean))
            truth.powers[name], truth.absorbed[name] = left, 1 - left / raw
            truth.required += (name,)
            truth.parameters[name] = parameters
            output = changed
    return output, {}


def sized(
    rng: np.random.Generator,
    name: str,
    motion: Motion,
    clean: np.ndarray,
    oracle: Oracle,
    power: float,
) -> dict[str, float]:
    """Return parameters of the effect, on one axis or on all, that have this power."""
    physics = EFFECTS[name]
    if name == "bandwidth":
        parameters = {f"{rng.choice(['accel', 'gyro'])}_cutoff": 40.0}
        parameters["order"] = float(rng.integers(1, 3))
        # What a low-pass takes away goes with one over its cut-off.
        for _ in range(3):
            left, _raw = oracle.power(motion.pick(distort(motion, clean, name, parameters) - clean))
            key = next(iter(parameters))
            parameters[key] = float(np.clip(parameters[key] * np.sqrt(left / power), 5, 300))
        return parameters
    shape = physics.shapes(rng, motion)
    names = list(physics.typical)
    if not physics.joint and rng.random() < 0.5:
        names = [str(rng.choice(names))]
    weights = {n: physics.typical[n] * float(rng.normal(0, 1)) for n in names}
    if len(names) == 1:
        weights = {n: physics.typical[n] * float(rng.choice([-1.0, 1.0])) for n in names}
    change = distort(motion, clean, name, {**weights, **shape}) - clean
    factor = np.sqrt(power / max(oracle.power(motion.pick(change))[0], 1e-12))
    cap = SHAKEN_CAP if "shaken" in physics.needs else CAP
    factor = min(factor, *(cap * physics.typical[n] / abs(w) for n, w in weights.items()), 1e6)
    return {**{n: factor * w for n, w in weights.items()}, **shape}


def spoil(
    rng: np.random.Generator,
    name: str,
    motion: Motion,
    clean: np.ndarray,
    oracle: Oracle,
    truth: Truth,
) -> dict:
    """Return options of the read-out that make the effect."""
    sampled = motion.pick(clean)
    truth.required += (name,)
    speed = np.abs(sampled[:, 3:]).max(axis=1)
    part = motion.setting.part
    sigma = np.array(part.density) * np.sqrt(motion.setting.rate / 2)
    if name == "saturation":
        limit = float(speed.max() * rng.uniform(0.75, 0.95))
        truth.parameters[name] = {"gyro_full_scale": limit}
        clipped = np.concatenate((sampled[:, :3], np.clip(sampled[:, 3:], -limit, limit)), axis=1)
        truth.powers[name] = oracle.power(clipped - sampled)[0]
        return {"full_scale": (np.inf, limit)}
    if name == "quantization":
        coarse = sigma * rng.uniform(3, 6)
        triad = int(rng.integers(2))
        lsb = tuple(float(coarse[t]) if t == triad else part.lsb[t] for t in range(2))
        key = ("accel_lsb", "gyro_lsb")[triad]
        truth.parameters[name] = {key: lsb[triad]}
        return {"lsb": lsb}
    if name == "dropped_samples":
        fast = np.flatnonzero(speed > 0.6 * speed.max())
        at = int(rng.choice(fast))
        count = int(rng.integers(1, 4))
        lost = np.zeros_like(sampled)
        lost[at : at + count, 3:] = sampled[at : at + count, 3:]
        truth.powers[name] = oracle.power(lost)[0]
        truth.parameters[name] = {"count": float(count)}
        return {"lost": (at / motion.setting.rate, count)}
    if name == "unit_error":
        factors = ((1 / 9.80665, 1.0), (1.0, 180 / np.pi), (2.0, 1.0), (1.0, 0.5))
        return {"factor": factors[int(rng.integers(len(factors)))]}
    orders = ((2, -1, 3), (1, 2, -3), (-1, -2, 3), (3, 1, 2))
    return {"order": orders[int(rng.integers(len(orders)))]}


def report(results: list[Result]) -> int:
    """Print the tables; return 1 if a goal is missed."""
    missed = 0
    small = [r for r in results if min(r.truth.powers.values(), default=np.inf) < 0.5 * SMALLEST]
    results = [r for r in results if r not in small]
    if small:
        print("too small at the largest size that is physical:", *(r.case.label for r in small))
    single = [r for r in results if r.case.part == "single"]
    print("| what | size | recordings | found | right name | or a stated rival | false name |")
    print("|---|---|---|---|---|---|---|")
    for part in ("single", "pairs", "readout", *REFERENCES):
        chosen = [r for r in results if r.case.part == part and r.case.names]
        for times in sorted({r.case.times for r in chosen}):
            group = [r for r in chosen if r.case.times == times]
            looked = [(r, n) for r in group for n in r.case.names]
            n = len(looked)
            found = sum(bool(r.answer["findings"] or r.answer["unexplained"]) for r, _ in looked)
            right = sum(r.named(name) for r, name in looked)
            among = sum(r.among(name) for r, name in looked)
            false = sum(bool(r.false) for r in group)
            print(
                f"| {part} | {times:g} | {len(group)} | {found / n:.0%} | {right / n:.0%} | "
                f"{among / n:.0%} | {false / len(group):.1%} |"
            )
            missed += part not in ("pairs", "readout") and times >= 1.5 and among / n < 0.98
    for part in ("clean", "outside", *REFERENCES):
        group = [r for r in results if r.case.part == part]
        if part in REFERENCES:
            group = [r for r in group if not r.case.names]
        if not group:
            continue
        false = sum(bool(r.false) for r in group)
        label = f"clean, {part}" if part in REFERENCES else part
        line = f"\n{label}: {false} of {len(group)} recordings got a false name"
        if part != "outside":
            line += f", {sum(bool(r.answer['unexplained']) for r in group)} something unexplained"
            missed += false / len(group) > 0.005
        else:
            line += f", {sum(r.overlap >= 0.5 for r in group)} unexplained in the right place"
            missed += false / len(group) > 0.05
            missed += sum(r.overlap >= 0.5 for r in group) / len(group) < 0.9
        print(line)
    real = [r for r in results if r.truth.setting.misaligned]
    if real:
        named = sum(r.named("gyro_misalignment") for r in real)
        print(f"\ngyro misalignment of real parts: named in {named} of {len(real)}")
    errors = [z for r in results for _, z in r.errors()]
    if errors:
        inside = float(np.mean(np.abs(errors) < 3))
        print(f"\nparameters within 3 standard errors: {inside:.1%} of {len(errors)}")
        missed += inside < 0.99
    single += [r for r in results if r.case.part in REFERENCES]
    lost = sorted({n for r in single for n in r.case.names if not r.among(n)})
    if lost:
        print("\nnot named:", ", ".join(lost))
    seconds = np.array([r.seconds for r in results])
    print(f"\nCPU per recording: median {np.median(seconds):.1f} s, most {seconds.max():.1f} s")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
