"""Studies of closed surfaces alone are built to the end, with and without folds."""

import numpy as np
import pytest

from ostiform.evaluation import Division, read_evaluation
from ostiform.pipeline import Note, Stage, build_study
from ostiform.surface import write_surface
from tests.star_shapes import closed_domain, star_embedding

STUDY = """
schema = 1
[parts.bone]
[shapes]
pattern = "{{subject}}.vtp"
[template]
points = 300
[correspondence]
levels = 2
[evaluation]
folds = {folds}
specificity_samples = 20
"""


@pytest.fixture
def study_of(tmp_path, rng):
    """Write a study of five smooth closed surfaces that asks for so many folds."""
    for number in range(5):
        axes = 20.0 + 3.0 * rng.random(3) + [10.0, 0.0, -5.0]

        def radius(u, axes=axes):
            return 1.0 / np.sqrt(((u / axes) ** 2).sum(axis=1)) * (1.0 + 0.1 * u[:, 0] * u[:, 1])

        shape = star_embedding(closed_domain().spheres[0], radius, 500).component
        write_surface(tmp_path / f"s{number}.vtp", shape.vertices, shape.faces)

    def write(folds):
        path = tmp_path / "study.toml"
        path.write_text(STUDY.format(folds=folds), encoding="utf-8")
        return path

    return write


def test_closed_surfaces_are_built_to_the_report_without_folds(study_of, tmp_path):
    told = []
    summary = build_study(study_of(0), tmp_path / "out", on_event=told.append)
    assert summary.failures == ()
    said = [event.text for event in told if isinstance(event, Note)]
    assert "generalisation: not measured, the study asks for no folds" in said
    assert read_evaluation(tmp_path / "out" / "optimal" / "evaluation.json").generalisation is None
    assert not (tmp_path / "out" / "folds").exists()
    report = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "A closed surface has no opening from which" in report
    assert "surface residue of left-out shapes" not in report


def test_folds_asked_for_are_groups_of_subjects_and_no_mode_counts_twice(study_of, tmp_path):
    build_study(study_of(2), tmp_path / "out", until=Stage.EVALUATE)
    found = read_evaluation(tmp_path / "out" / "optimal" / "evaluation.json").generalisation
    assert found.division is Division.SUBJECT_GROUPS
    assert len(list((tmp_path / "out" / "folds").iterdir())) == 2
    assert found.mode_counts.tolist() == [0, 1]  # the smaller fold trains on two shapes
