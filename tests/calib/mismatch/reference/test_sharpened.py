"""A captured motion with what a smoothing took put back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfreqz

from calib.effects import get_effect
from calib.effects.base import State, Term
from calib.mismatch.reference.sharpened import (
    Sharpened,
    completed,
    dulled,
    lost_by,
    sharpening,
)
from calib.mismatch.reference.truths import RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import integrate_rate, mat_from_quat

STEP, BAND = 0.01, 10.0
SMOOTHED = Term("reference_smoothing", {"orientation_fourth": 5e-7, "position": 2e-4})


def moved(n: int = 4000) -> State:
    """Return a body that is waved, at up to 8 Hz."""
    rng = np.random.default_rng(1)
    time = STEP * np.arange(n)
    rate, away = (gaussian_filter1d(rng.normal(size=(n, 3)), 3.0, axis=0) for _ in range(2))
    mat = mat_from_quat(integrate_rate(time, 20.0 * rate))
    force = np.einsum("nji,nj->ni", mat, 20.0 * away + [0.0, 0.0, 9.8])
    return State(time=time, force=force, rate=20.0 * rate, mat_ns=mat)


@pytest.mark.parametrize("rate", [60.0, 100.0, 240.0])
@pytest.mark.parametrize("cutoff", [3.0, 6.0, 10.0])
def test_a_butterworth_both_ways_is_undone(cutoff: float, rate: float) -> None:
    """Of samples too few for its cut-off as well: there it is steeper than one in the air."""
    frequency = np.linspace(0.1, BAND, 50)
    _, once = sosfreqz(butter(2, cutoff, fs=rate, output="sos"), frequency, fs=rate)
    # As slow as that it is 1 - m (2 pi f)^4.
    size = (2.0 * rate * np.tan(np.pi * cutoff / rate)) ** -4
    sizes = {"orientation_fourth": size}
    angles, places = sharpening(
        frequency, sizes, bands=(2.0 * BAND, 2.0 * BAND), interval=1.0 / rate
    ).T
    assert np.abs(once) ** 2 * angles == pytest.approx(1.0, rel=1e-3)
    assert (places == 1.0).all()


def test_what_is_faster_than_the_comparison_is_not_put_back() -> None:
    sizes = {"orientation_fourth": 2.5e-6, "position": 2e-3}
    within, beyond = (
        sharpening(np.array([BAND, 20.0 * BAND]), sizes, bands=(BAND, BAND), interval=1e-3) - 1
    )
    square = (2.0 * np.pi * BAND) ** 2
    assert within == pytest.approx([2.5e-6 * square**2, 2e-3 * square], rel=0.01)
    assert (beyond < 0.01 * within).all()


def test_a_dull_motion_is_what_sharpening_makes_the_motion_of() -> None:
    true = moved()
    way = {"bands": (BAND, BAND), "interval": STEP}
    seen = dulled(true, SMOOTHED.parameters, **way)
    room = [np.einsum("nij,nj->ni", true.mat_ns, own.force) for own in (true, seen)]
    spectra = [np.fft.rfft(own * np.hanning(len(own))[:, None], axis=0) for own in room]
    frequency = np.fft.rfftfreq(len(true.time), STEP)
    inside = (frequency > 1.0) & (frequency < 8.0)
    ratio = (spectra[0] * spectra[1].conj())[inside].real / np.abs(spectra[1][inside]) ** 2
    expected = sharpening(frequency[inside], SMOOTHED.parameters, **way)[:, 1:]
    assert np.median(ratio / expected) == pytest.approx(1.0, abs=1e-3)


def test_what_a_smoothing_takes_is_that_of_the_captured_motion() -> None:
    """Steps of its size are then in proportion: a sharper motion would have more to lose."""
    true = moved()
    seen = dulled(true, SMOOTHED.parameters, bands=(BAND, BAND), interval=STEP)
    effect = get_effect(SMOOTHED.effect)
    beside = effect.columns(replace(true, captured=seen), {})
    for name in ("orientation_fourth", "position_fourth"):
        for channel, values in effect.columns(seen, {})[name].items():
            error = beside[name][channel] - values
            assert np.std(error) < 0.2 * np.std(values), (name, channel)


def test_a_truth_is_sharpened_once_for_the_same_sizes() -> None:
    n = 60
    recording = Recording(STEP * np.arange(n), np.zeros((n, 3)), np.zeros((n, 3)), "device")
    truth, asked = RecordingTruth(recording, 9.8), []

    def sharpen(sizes: dict[str, float]) -> RecordingTruth:
        asked.append(dict(sizes))
        return replace(truth)

    sharpened = Sharpened(truth, sharpen)
    assert sharpened.before({}) is truth
    one, two = {"position": 1e-4}, {"position": 2e-4}
    first = sharpened.before(one)
    assert sharpened.before(two) is not first
    assert sharpened.before(dict(one)) is first
    assert asked == [one, two]
    assert Sharpened(truth, None).before(one) is truth


def test_the_sensor_is_the_model_without_what_was_done_to_the_truth() -> None:
    n = 60
    recording = Recording(STEP * np.arange(n), np.zeros((n, 3)), np.zeros((n, 3)), "device")
    truth, other = RecordingTruth(recording, 9.8), Term("gravity_magnitude", {"error": 0.01})
    model = SensorModel(terms=(other, SMOOTHED, Term(SMOOTHED.effect, {"position": 1e-4})))
    assert lost_by(model) == pytest.approx({"orientation_fourth": 5e-7, "position": 3e-4})
    assert Sharpened(truth, lambda _: truth).sensor(model).terms == (other,)
    # Beside a truth that cannot be sharpened it stays a term.
    assert Sharpened(truth, None).sensor(model) is model


@pytest.mark.parametrize(
    ("sizes", "sharpens"),
    [
        ({"position_fourth": -1e-6}, False),
        ({"orientation": -1e-5}, False),
        ({"orientation": -2e-4, "orientation_fourth": 1e-8}, False),
        ({"orientation": -1e-5, "orientation_fourth": 1e-8}, True),
        ({"orientation": 1e-5, "position": -1e-5}, False),
    ],
)
def test_what_is_no_low_pass_is_not_undone(sizes: dict[str, float], sharpens: bool) -> None:
    n = 60
    recording = Recording(STEP * np.arange(n), np.zeros((n, 3)), np.zeros((n, 3)), "device")
    truth, model = (
        RecordingTruth(recording, 9.8),
        SensorModel(terms=(Term(SMOOTHED.effect, sizes),)),
    )
    assert lost_by(model) == (sizes if sharpens else {})
    assert (Sharpened(truth, lambda _: truth).sensor(model) is model) != sharpens


def test_what_is_seen_completes_what_is_said_of_angles_and_positions() -> None:
    seen = {"orientation_fourth": 5e-7, "position": 2e-4}
    assert completed({}, seen) == seen
    said = {"orientation": 1e-4}
    assert completed(said, seen) == {"orientation": 1e-4, "position": 2e-4}
    both = {**said, "position_fourth": 4e-7}
    assert completed(both, seen) == both
