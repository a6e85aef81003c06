"""What a screen and a page say of a diagnosis."""

from imu_cli.report.diagnosis import diagnosis_report
from imu_cli.report.model import Paragraph
from imu_cli.report.words import (
    MENDED_FIRST,
    SPELT,
    alternatives,
    chance,
    headline,
    likelihood,
    much,
    notes,
    remarks,
    rival_of,
    shift_of,
    spans,
    what,
    where,
)

DOCUMENT = {
    "verdict": "consistent",
    "findings": [],
    "unexplained": [],
    "recording": {
        "poses": 92,
        "poses_used": 80,
        "stamps": "1.2 ms",
        "rounded_stamps": "to 0.1 s: samples are taken as even, at 99.70 Hz",
        "swapped_markers": {"samples": 3, "intervals": [[1.0, 1.25]]},
        "jumps": {"samples": 38, "intervals": [[4.85, 5.15]]},
        "corners": 41,
        "silent": "gyro.x",
    },
}


def test_everything_that_was_done_to_a_recording_is_said_on_the_page() -> None:
    said = notes(DOCUMENT)
    for words in (
        "80 of 92 poses",
        "1.2 ms",
        "rounded to 0.1 s: samples are taken as even, at 99.70 Hz.",
        "3 samples",
        "1.00 to 1.25 s",
        "5.15 s",
        "41",
        "gyro.x",
    ):
        assert any(words in sentence for sentence in said)
    pages = [b for b in diagnosis_report(DOCUMENT).blocks if isinstance(b, Paragraph)]
    assert tuple(said) in [page.sentences for page in pages]


def test_nothing_is_said_where_nothing_was_done() -> None:
    plain = {**DOCUMENT, "recording": {"poses": 20, "poses_used": 20}}
    assert notes(plain) == []
    assert not diagnosis_report(plain).blocks


def test_where_a_finding_is() -> None:
    finding = {
        "channels": ["gyro.x", "gyro.y"],
        "intervals": [[-0.01, 5], [7, 9.04]],
        "regime": "|w|",
    }
    assert where(finding) == "gyro.x, gyro.y; 0.0 to 5.0 s, 7.0 to 9.0 s; follows |w|"
    assert where({**finding, "intervals": []}) == "gyro.x, gyro.y; follows |w|"


def test_intervals_are_said_to_as_many_digits_as_asked_for() -> None:
    assert spans([[-0.001, 1.0], [7, 9.046]], digits=2) == "0.00 to 1.00 s, 7.00 to 9.05 s"
    assert spans([[-0.001, 1.0], [7, 9.046]], " and ") == "0.0 to 1.0 s and 7.0 to 9.0 s"


def test_of_very_many_intervals_the_first_few_are_written_and_how_many_more() -> None:
    many = [(float(k), k + 0.5) for k in range(SPELT)]
    assert spans(many).count(" to ") == SPELT
    text = spans([*many, (100.0, 101.0), (200.0, 201.5)])
    assert text.startswith("0.0 to 0.5 s, 1.0 to 1.5 s, ")
    assert text.endswith("and 3 more until 201.5 s")


def test_a_chance_is_not_said_beyond_what_the_noise_model_knows() -> None:
    assert [chance(p) for p in (1e-306, 1e-6, 2e-6, 0.0123)] == ["< 1e-6"] * 2 + ["2e-6", "0.012"]
    assert chance(1.0) == "1"


def test_the_log_likelihood_is_said_where_something_was_fitted() -> None:
    both = {"before": -33570.34, "after": -187.81}
    assert likelihood({"log_likelihood": both}) == "Log-likelihood: -33570.3 -> -187.8."
    assert likelihood({"log_likelihood": None}) == ""
    assert likelihood({"log_likelihood": {"before": -187.81, "after": -187.81}}) == ""


def test_what_is_seen_in_samples_follows_nothing_and_is_said_as_it_is() -> None:
    assert what("nothing: it is stuck") == "it is stuck"
    assert what("its own rate") == "follows its own rate"


def test_rivals_are_said_by_how_probable_they_are_beside_the_finding() -> None:
    assert rival_of({"effect": "earth_rate", "odds": 12.34}) == "earth_rate, 12 times as probable"
    assert rival_of({"effect": "earth_rate", "odds": 0.1}) == "earth_rate, 0.1 times as probable"
    assert rival_of({"effect": "earth_rate", "odds": 1.0}) == "earth_rate, just as probable"
    fluctuating = {"effect": "fluctuation in a window accel", "odds": 0.5}
    assert rival_of(fluctuating) == "fluctuation in a window (accel), 0.5 times as probable"


def test_few_rivals_are_said_the_likeliest_first_and_what_is_more_probable_as_such() -> None:
    odds = {"a": 0.2, "b": 29.4, "c": 1.0, "d": 0.1, "e": 0.15, "f": 0.3, "g": 0.12}
    rivals = [{"effect": name, "odds": value} for name, value in odds.items()]
    assert alternatives(rivals) == [
        "or, more probable: b, 29 times as probable",
        "or: c, just as probable",
        "or: f, 0.3 times as probable",
        "or: a, 0.2 times as probable",
        "or: e, 0.15 times as probable",
        "and 2 less probable ones",
    ]
    assert alternatives([]) == []


def test_what_had_taken_something_up_is_said_to_have_moved() -> None:
    """It read as if it had taken up a part of the effect, in its own unit."""
    item = {"parameter": "gyro.scale_factor_error.x", "shift": 0.00507, "unit": "1"}
    assert shift_of(item) == "+0.507 %"


def test_where_nothing_was_compared_not_everything_is_explained() -> None:
    document = {"verdict": "explained", "findings": [], "fit": {"residuals": []}}
    assert headline(document) == MENDED_FIRST
    compared = {**document, "fit": {"residuals": [{"rows": "accel at rest"}]}}
    assert headline(compared).startswith("Explained: everything")


def test_the_size_of_what_is_unexplained_says_where_it_shows() -> None:
    left = {"follows": "direction of gravity", "size": {"value": 0.0486, "unit": "m/s²"}}
    rests = {"residuals": [{"rows": "accel at rest"}]}
    windows = {"residuals": [{"rows": "accel over windows"}]}
    assert much(left, rests) == "up to 4.96 mg at rest"
    assert much(left, windows) == "up to 4.96 mg in the mean of a window"
    turning = {**left, "follows": "speed of rotation"}
    assert much(turning, rests) == ""
    assert much(turning, windows) == "up to 4.96 mg in the mean of a window"
    assert much({**left, "follows": "rate of temperature"}, rests) == "up to 4.96 mg at rest"
    assert much({**left, "size": None}, rests) == ""


def finding_of(effect: str, **parameters: tuple[float, float | None, str]) -> dict[str, object]:
    names = ("value", "sigma", "unit")
    return {
        "effect": effect,
        "parameters": {k: dict(zip(names, v, strict=True)) for k, v in parameters.items()},
    }


def test_repeated_samples_are_said_to_be() -> None:
    """It read "count = -9 samples", and that samples are missing (or repeated)."""

    def said(count: float) -> list[str]:
        moment = (3.0, 0.01, "s")
        return remarks(finding_of("dropped_samples", count=(count, None, "samples"), moment=moment))

    assert said(-9.0) == ["9 samples are repeated."]
    assert said(-1.0) == ["1 sample is repeated."]
    assert said(3.0) == ["3 samples are missing."]


def test_a_size_that_is_not_known_is_said_not_to_be() -> None:
    """A cut-off of 18 +- 16 Hz stood beside p = 0.0005."""
    there = (1.0, None, "presence")
    vague = finding_of("bandwidth", gyro=there, gyro_cutoff=(18.0, 16.0, "Hz"))
    assert remarks(vague) == ["gyro_cutoff: the effect is sure, this number is not."]
    assert remarks(finding_of("bandwidth", gyro=there, gyro_cutoff=(18.0, 2.0, "Hz"))) == []
    late = finding_of("time_offset", gyro_delay=(1e-3, 5e-4, "s"))
    assert remarks(late) == []
