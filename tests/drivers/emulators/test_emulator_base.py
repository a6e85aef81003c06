import numpy as np
import pytest

from calib.errors import AddressError
from drivers.emulators.base import EmulatorOptions, make_sensor


def test_noise_belongs_to_the_sample_number() -> None:
    sensor = make_sensor(EmulatorOptions(seed=3), default_rate=200.0)
    whole, _ = sensor.measure(0, 10_000)
    for start, stop in ((4090, 4100), (0, 1), (8191, 9000)):
        part, temperature = sensor.measure(start, stop)
        assert np.array_equal(part.accel, whole.accel[start:stop])
        assert np.array_equal(part.gyro, whole.gyro[start:stop])
        assert temperature.shape == (stop - start,)


def test_a_still_sensor_shows_its_own_errors() -> None:
    sensor = make_sensor(EmulatorOptions(seed=5), default_rate=100.0)
    signals, _ = sensor.measure(0, 20_000)
    truth = sensor.model.accel.distort(np.array([[0, 0, 9.80665]]))[0]
    sigma = 200e-6 * 9.80665 * np.sqrt(100 / 2)
    assert np.all(np.abs(signals.accel.mean(axis=0) - truth) < 5 * sigma / np.sqrt(20_000))
    assert np.allclose(signals.accel.std(axis=0), sigma, rtol=0.03)
    assert np.all(np.abs(signals.gyro.mean(axis=0) - sensor.model.gyro.bias) < 1e-4)


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        ("foo", "'foo' is no effect"),
        ("dropped_samples:count=1e9,moment=1", "at most [0-9]+, the samples"),
    ],
)
def test_an_effect_that_cannot_be_is_a_wrong_address(effect: str, said: str) -> None:
    """It was a traceback, and a billion samples more than memory."""
    options = EmulatorOptions(motion="bench", effects=(effect,))
    with pytest.raises(AddressError, match=said):
        make_sensor(options, default_rate=100.0)
