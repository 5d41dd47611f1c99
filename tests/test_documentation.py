"""The documentation says what the program does."""

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel

from ostiform.study import read_settings
from ostiform.study.settings import StudySettings

ROOT = Path(__file__).resolve().parents[1]
STUDIES = sorted((ROOT / "examples" / "studies").glob("*.toml"))


def keys(model: type[BaseModel]) -> set[str]:
    """Return the keys that a table of the study file may have, and those of the tables in it."""
    found: set[str] = set()
    for name, field in model.model_fields.items():
        found.add(field.alias or name)
        for inner in nested(field.annotation):
            found |= keys(inner)
    return found


def nested(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for argument in getattr(annotation, "__args__", ()) for m in nested(argument)]


def test_every_key_of_the_study_file_is_documented():
    text = (ROOT / "docs" / "study.md").read_text(encoding="utf-8")
    absent = {key for key in keys(StudySettings) if not re.search(rf"[`\[.]{key}[`\].]", text)}
    assert absent == set()


def test_the_first_example_of_the_study_page_is_a_study(tmp_path):
    text = (ROOT / "docs" / "study.md").read_text(encoding="utf-8")
    study = tmp_path / "study.toml"
    study.write_text(text.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    assert read_settings(study).ostium_names[:2] == ("LV.mitral", "LV.aortic")


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_the_example_studies_can_be_read(path):
    assert read_settings(path).part_names
    assert tomllib.loads(path.read_text(encoding="utf-8"))["shapes"]["folder"] == "."
