"""Process statistics against worked numbers and against chance."""

import numpy as np
import pytest

from imu_cli.line.statistics import capability, drifts, outliers


def test_cpk_of_a_worked_example() -> None:
    # mean 10, s 1 exactly: (9, 11, 9, 11, 10) scaled; limits 7 and 14 give min(3, 4) / 3 = 1.
    values = np.array([9, 11, 9, 11, 10.0])
    values = 10 + (values - 10) / np.std(values, ddof=1)
    result = capability("p", values, unit="1", low=7, high=14)
    assert result.cpk == pytest.approx(1.0)
    assert result.cpk_interval is not None
    assert result.cpk_interval[0] < 1 < result.cpk_interval[1]


def test_no_limit_or_no_spread_gives_no_cpk() -> None:
    assert capability("p", np.array([1.0, 2.0]), unit="1", low=None, high=None).cpk is None
    assert capability("p", np.array([1.0, 1.0]), unit="1", low=0, high=2).cpk is None


def test_an_outlier_is_found_and_chance_is_not() -> None:
    rng = np.random.default_rng(5)
    names = [f"u{k}" for k in range(40)]
    false = sum(
        bool(outliers(names, {f"p{j}": rng.normal(size=40) for j in range(10)})) for _ in range(200)
    )
    assert false <= 7  # 2 expected at 1 %
    column = rng.normal(size=40)
    column[7] = 20
    (found,) = outliers(names, {"p": column})
    assert found.serial_number == "u7"


def test_a_drift_is_found_and_chance_is_not() -> None:
    rng = np.random.default_rng(6)
    days = np.arange(40.0)
    false = sum(
        bool(drifts("s", days, {f"p{j}": rng.normal(size=40) for j in range(10)}))
        for _ in range(200)
    )
    assert false <= 7
    (found,) = drifts("s", days, {"p": 0.1 * days + rng.normal(size=40)})
    assert found.slope_per_day == pytest.approx(0.1, abs=0.03)
