import re

import pytest

from ostiform.errors import InputError
from ostiform.pipeline.check import check_study
from tests.oracles.mesh_zoo import ZOO, study_of


@pytest.mark.parametrize("specimen", ZOO, ids=[specimen.flaw for specimen in ZOO])
def test_a_flawed_mesh_is_mended_or_refused_in_one_sentence(specimen, tmp_path):
    path = study_of(specimen, tmp_path / "study")
    if specimen.flaw.startswith("duplicated "):  # the study itself is refused
        with pytest.raises(InputError, match=specimen.word):
            check_study(path)
        return
    checks = check_study(path)
    problems = [check.problem for check in checks if check.problem]
    repairs = "; ".join(repair for check in checks for repair in check.repairs)
    if specimen.outcome == "refused":
        (problem,) = problems
        assert problem.startswith("shape bad: ")
        assert re.search(specimen.word, problem)
    else:
        assert problems == []
        assert bool(repairs) == (specimen.outcome == "repaired")
        assert re.search(specimen.word, repairs)


def test_no_repair_is_made_where_the_study_forbids_it(tmp_path):
    specimen = next(s for s in ZOO if s.flaw == "duplicate faces")
    path = study_of(specimen, tmp_path / "study")
    text = path.read_text(encoding="utf-8").replace("schema = 1", "schema = 1\nrepair = false")
    path.write_text(text, encoding="utf-8")
    (problem,) = [check.problem for check in check_study(path) if check.problem]
    assert "needs no repair (repair = false), found one that needs: dropped 6 repeated" in problem
