"""Which sets of an effect's parameters are tried, and what each is worth beforehand."""

from collections import defaultdict

import pytest

from calib.effects import get_effect
from calib.mismatch.hypotheses.families import PHYSICAL, add_catalogue, tried_effects
from calib.mismatch.hypotheses.score import Stack

from ..bench import problem


@pytest.fixture(scope="module")
def catalogue() -> Stack:
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = Stack(len(rows.residual))
    add_catalogue(stack, rows)
    return stack


def sets_of(stack: Stack, slug: str) -> dict[tuple[str, ...], float]:
    """Return the sets of parameters of an effect, with the weight that each has of all."""
    weight: dict[tuple[str, ...], float] = defaultdict(float)
    for candidate in stack:
        if candidate.name == slug:
            weight[candidate.parameters] += candidate.weight
    return {names: each / sum(weight.values()) for names, each in weight.items()}


def test_no_effect_is_likelier_than_another_beforehand(catalogue):
    total: dict[str, float] = defaultdict(float)
    for candidate in catalogue:
        total[candidate.name] += candidate.weight
    share = PHYSICAL / len(tried_effects())
    assert max(total.values()) <= share + 1e-12
    # What shows at none of some shapes is worth less.
    whole = {slug: each for slug, each in total.items() if not get_effect(slug).shape}
    assert whole == pytest.approx(dict.fromkeys(whole, share))
    assert len(whole) > 12


def test_a_matrix_is_tried_element_by_element_in_rows_along_its_diagonal_and_whole(catalogue):
    sets = sets_of(catalogue, "gyro_g_sensitivity")
    every = [f"g{i}{j}" for i in "xyz" for j in "xyz"]
    rows = [tuple(f"g{i}{j}" for j in "xyz") for i in "xyz"]
    alone = [(name,) for name in every]
    some = [*rows, ("gxx", "gyy", "gzz")]
    assert set(sets) == {*alone, *some, tuple(every)}
    for part in (alone, some, [tuple(every)]):
        assert sum(sets[names] for names in part) == pytest.approx(1 / 3)
    assert set(sets_of(catalogue, "gyro_misalignment")) >= {("mxy", "mxz"), ("mzx", "mzy")}


def test_a_vector_is_tried_axis_by_axis_and_whole(catalogue):
    sets = sets_of(catalogue, "accel_quadratic")
    assert sets == pytest.approx(
        {("kx",): 1 / 6, ("ky",): 1 / 6, ("kz",): 1 / 6, ("kx", "ky", "kz"): 1 / 2}
    )


def test_the_earth_turns_about_all_axes_of_a_frame_of_unknown_heading_or_not_at_all(catalogue):
    """One of them alone would be noise that happens to lie along it: of no latitude's size."""
    assert sets_of(catalogue, "earth_rate") == {("east", "north", "up"): 1.0}


def test_what_refines_comes_with_all_that_it_refines(catalogue):
    for names in sets_of(catalogue, "gyro_bias_temperature"):
        assert not {"cx", "cy", "cz"} & set(names) or len(names) == 9
