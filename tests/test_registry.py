"""Every registered thing, whatever it is: a new file is tested here with no edit.

Each registry has its section; add yours below.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.chips import chips, get_chip, normal_name
from drivers.chips.base import Setup
from drivers.emulators import emulators
from drivers.emulators.chips import chip_models
from drivers.transports import make_driver, transports

TESTS = Path(__file__).parent

# ---- chips ----


@pytest.mark.parametrize("name", chips())
def test_a_chip_has_its_model_its_exchange_and_its_source(name: str) -> None:
    chip = chips()[name]
    assert name in chip_models(), f"add drivers/emulators/chips/{name}.py with a MODEL"
    assert (TESTS / "drivers/chips/exchanges" / f"{name}.txt").exists()
    assert chip.source
    assert chip.__doc__


@pytest.mark.parametrize("name", chips())
def test_a_chip_s_tables_are_sound(name: str) -> None:
    chip = chips()[name]
    for table in (chip.accel_ranges, chip.gyro_ranges):
        assert len({row.code for row in table}) == len(table)
        for row in table:
            # Counts are 16 bits signed: the range fills them, to the 5 % that gyroscopes leave.
            assert row.full_scale * row.counts == pytest.approx(32768, rel=0.13)
    chip.check(Setup(*chip.default_ranges, chip.default_rate))
    assert {"accel", "gyro", "temperature"} <= set(chip.frame.names or ())
    assert chip.fifo_frame <= chip.fifo_size
    for biases in chip.biases:
        parameters = [field.parameter for field in biases]
        assert len(set(parameters)) == len(parameters)
    for part in (*chip.models.values(), *chip.aliases):
        assert get_chip(part) is chip
        assert get_chip(normal_name(part)) is chip
        assert normal_name(part) in emulators()


def test_no_two_chips_answer_alike() -> None:
    keys = [
        (place, chip.identity.address, value)
        for chip in chips().values()
        for place in chip.addresses
        for value in chip.models
    ]
    assert len(set(keys)) == len(keys)


# ---- transports and emulators ----


@pytest.mark.parametrize("scheme", transports())
def test_a_transport_s_example_makes_a_driver_without_any_io(scheme: str) -> None:
    transport = transports()[scheme]
    assert transport.example.startswith(f"{scheme}://")
    assert not make_driver(transport.example).is_open


@pytest.mark.parametrize("name", emulators())
def test_an_emulator_gives_samples_of_a_resting_sensor(name: str) -> None:
    with make_driver(f"emulator://{name}?speed=0&seed=1") as driver:
        batches = []
        while sum(map(len, batches)) < 100:
            batch = driver.read(5.0)
            assert batch is not None
            batches.append(batch)
    accel = np.concatenate([batch.accel for batch in batches])
    gyro = np.concatenate([batch.gyro for batch in batches])
    # At rest but for a consumer part's errors: 40 mg and 2 °/s, five times over.
    assert np.linalg.norm(accel.mean(axis=0)) == pytest.approx(9.81, abs=2.0)
    assert np.abs(gyro.mean(axis=0)).max() < np.deg2rad(10)
