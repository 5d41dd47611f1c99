import json

import pytest

from ostiform.cli.check import check
from ostiform.cli.init import init
from ostiform.cli.options import Common
from ostiform.surface import write_surface
from tests.oracles.mesh_zoo import ZOO, sound, study_of


def specimen(flaw):
    return next(item for item in ZOO if item.flaw == flaw)


def test_check_prints_the_columns_and_fails_where_a_shape_is_not_usable(tmp_path, capsys):
    path = study_of(specimen("genus 1"), tmp_path / "study")
    assert check(path, common=Common(workers=1)) == 2
    printed = capsys.readouterr().out
    for column in ("shape", "part", "vertices", "openings", "genus", "components", "verdict"):
        assert column in printed
    assert "3 of 4 shapes can be used" in printed


def test_check_gives_genus_openings_and_components_of_what_it_refuses(tmp_path, capsys):
    path = study_of(specimen("genus 1"), tmp_path / "study")
    check(path, common=Common(workers=1, json=True))
    (bad,) = [item for item in json.loads(capsys.readouterr().out) if item["problem"]]
    (row,) = bad["parts"]
    assert (row["genus"], row["n_openings"], row["n_components"]) == (1, 0, 1)


def test_check_is_content_with_mended_shapes(tmp_path, capsys):
    path = study_of(specimen("duplicate faces"), tmp_path / "study")
    assert check(path, common=Common(workers=1)) == 0
    printed = capsys.readouterr().out
    assert "LA: dropped 6 repeated triangles" in printed
    assert "4 of 4 shapes can be used" in printed


def test_check_says_the_same_of_several_shapes_once(tmp_path, capsys):
    vertices, faces = sound()
    for name, scale in zip("abcde", (0.98, 0.99, 1.0, 1.01, 1.03), strict=True):
        write_surface(tmp_path / f"{name}.vtp", scale * vertices, faces[:, ::-1])
    init(tmp_path)
    capsys.readouterr()
    assert check(tmp_path / "study.toml", common=Common(workers=1)) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "inside-out" in line]
    assert " and 2 more: " in line


def test_init_writes_a_study_that_check_accepts_and_overwrites_nothing(tmp_path, capsys):
    vertices, faces = sound()
    for name, scale in (("a", 0.98), ("b", 1.0), ("c", 1.03)):
        write_surface(tmp_path / f"{name}.vtp", scale * vertices, faces)
    assert init(tmp_path) == 0
    assert check(tmp_path / "study.toml", common=Common(workers=1, quiet=True)) == 0
    assert init(tmp_path) == 2
    assert "expected no file of this name, found one" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["init", "check"])
def test_the_commands_are_registered(name):
    from ostiform.cli import COMMANDS

    assert name in COMMANDS
