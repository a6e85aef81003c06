"""What to record so that rivals come apart."""

from calib.effects import get_effect
from calib.mismatch.findings.diagnosis import Rival
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.separate import OF_MOTION, to_separate
from calib.mismatch.search.twins import HEADING

from ..bench import problem


def test_every_rival_comes_with_what_to_record():
    _, made = problem()
    stack = make_stack(made.rows(), skip=(), reference=False)
    groups = sorted({c.group for c in stack if not c.physical})
    own = get_effect("gyro_scale_asymmetry")
    for group in groups:
        said = to_separate(own, (Rival(group, 0.2),))
        assert own.needs in said
        assert f"{group}: " in said
    # Those that follow the motion have words of their own, and no words are left over.
    followed = {g.rpartition(" ")[0] for g in groups}
    assert set(OF_MOTION) <= {HEADING, *followed}
    assert "markers" in to_separate(own, (Rival(HEADING, 1.0),))
    assert "turns at several rates" in to_separate(own, (Rival("its own rate gyro.z", 0.2),))
    assert "happened once" in to_separate(own, (Rival("bias in a window gyro.z", 0.2),))
