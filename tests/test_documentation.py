"""The documentation says what the program does."""

import ast
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


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_every_page_is_in_the_contents():
    listed = set(re.findall(r"^[\w/-]+$", text_of("docs/index.md"), re.MULTILINE))
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert pages - listed == set()


def test_every_package_has_a_page_of_its_interface():
    packages = {path.parent.name for path in (ROOT / "src" / "ostiform").glob("*/__init__.py")}
    contents = text_of("docs/api.md")
    for package in packages - {"api", "cli"}:
        assert f"api/{package}\n" in contents, package
        assert f"automodule:: ostiform.{package}\n" in text_of(f"docs/api/{package}.md")


def test_every_command_is_on_the_page_of_the_command_line():
    from ostiform.cli import COMMANDS

    text = text_of("docs/command-line.md")
    assert {name for name in COMMANDS if f"`{name}`" not in text} == set()


def test_every_exit_code_is_on_the_page_of_the_command_line():
    from ostiform.cli.running import EXIT_CODES, OTHER_FAILURE
    from ostiform.cli.supervisor import INTERRUPTED

    for code in (0, OTHER_FAILURE, *EXIT_CODES.values(), INTERRUPTED):
        assert f"\n| {code} |" in text_of("docs/command-line.md")


def messages_of_the_program() -> str:
    """Every piece of text of the source, a gap where a value is filled in."""
    found = []
    for path in (ROOT / "src" / "ostiform").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
            elif isinstance(node, ast.JoinedStr):
                found.append(
                    "".join(
                        str(p.value) if isinstance(p, ast.Constant) else "\0" for p in node.values
                    )
                )
            elif isinstance(node, ast.BinOp):
                parts = [p for p in ast.walk(node) if isinstance(p, ast.JoinedStr | ast.Constant)]
                found.append("".join(str(getattr(p, "value", "")) for p in parts))
    return "\n".join(found)


def test_the_messages_of_the_questions_page_are_those_of_the_program():
    said = messages_of_the_program()
    terms = re.findall(r"^\*(.+)\*$", text_of("docs/faq.md"), re.MULTILINE)
    assert len(terms) > 30
    absent = []
    for message in (piece for term in terms for piece in term.split("*, *")):
        for piece in re.split(r"\.\.\.|\b\d+\b|`[^`]*`", message):
            words = piece.strip(" ,:()")
            if len(words) > 8 and words not in said:
                absent.append(words)
    assert absent == []


@pytest.mark.xdist_group("example")
def test_the_example_of_the_readme_runs(example_folder, tmp_path, monkeypatch, capsys):
    code = text_of("README.md").split("```python\n")[1].split("```")[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 15
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102
    assert "15 shapes, 500 points" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"hearts.png", "mode.pdf", "evidence.svg"}


def test_the_shell_commands_of_the_readme_exist():
    from ostiform.cli import COMMANDS

    named = set(re.findall(r"\bostiform ([a-z]+)\b", text_of("README.md")))
    assert named - {"turns"} <= set(COMMANDS)
