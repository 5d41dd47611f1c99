"""A level that ended for another reason than its stopping rule is named, and only such a level."""

from ostiform.correspondence import LevelStatus
from ostiform.pipeline.correspond import convergence_warning


def test_levels_that_converged_give_no_warning():
    assert convergence_warning((LevelStatus.CONVERGED,) * 3) == ""


def test_only_levels_that_did_not_converge_are_named_with_their_reason():
    said = convergence_warning(
        (LevelStatus.CONVERGED, LevelStatus.SWEEP_LIMIT, LevelStatus.CONVERGED, LevelStatus.STALLED)
    )
    assert said.startswith("correspondence did not converge (level 2: ")
    assert f"level 2: {LevelStatus.SWEEP_LIMIT.value}" in said
    assert f"level 4: {LevelStatus.STALLED.value}" in said
    assert "level 1" not in said
    assert "level 3" not in said
