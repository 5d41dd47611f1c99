"""What a stranger relies on: citations that lead somewhere, names, versions, pinned tools."""

import re
import tomllib
from collections import defaultdict
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import ostiform

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "ostiform"
CITING = [
    path
    for folder in ("src", "tests", "benchmarks", "docs", "examples")
    for pattern in ("*.py", "*.pyi", "*.md", "*.toml")
    for path in sorted((ROOT / folder).rglob(pattern))
    if path != Path(__file__) and not {"_build", "gallery"} & set(path.parts[:-1])
]

SAME_ROLE = {
    "types": "the values of a package",
    "settings": "how a package's work is to be done",
    "files": "readers and writers of a package's values",
    "landmarks": "what a package does with landmarks that a user states",
    "levels": "variation between and within subjects: divided, judged",
    "dynamics": "the dynamic model: made, judged",
    "prediction": "cycles predicted from a few phases: made, judged",
    "cycles": "whole cycles of motion: made, reported",
    "population": "the population of a study: named, reported",
    "truth": "generated shapes know it, the evaluation measures by it",
    "tables": "the writer of all tables; tables for other programs",
}
"""Module names that several packages have, and what they mean in each of them."""

COMMANDS_AND_STAGES = {"cli", "pipeline"}
"""A command has the name of what it runs, and a stage of what it calls."""


def cited_sections(text: str) -> set[int]:
    """Give the sections that the text cites as ``(design 5, 6)`` or ``design 3``."""
    found: set[int] = set()
    for numbers in re.findall(r"\bdesign (\d+(?:, \d+)*)\b", text):
        found |= {int(number) for number in numbers.split(", ")}
    return found


def design_sections() -> set[int]:
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    return {int(number) for number in re.findall(r"^## (\d+)\. ", text, re.MULTILINE)}


def test_the_design_has_the_sections_that_code_has_always_cited():
    assert design_sections() == set(range(1, 9))


def test_every_citation_leads_to_a_page_or_a_section_of_the_repository():
    sections = design_sections()
    pages = {path.name for path in ROOT.rglob("*.md")}
    for path in CITING:
        text = path.read_text(encoding="utf-8")
        assert cited_sections(text) - sections == set(), path
        cited = set(re.findall(r"(?<![\w<>{}*-])([\w-]+\.md)\b", text))
        assert cited - pages == set(), path


def test_a_citation_of_a_section_that_is_not_there_is_found():
    assert cited_sections("As in (design 5, 12) and (HY 2.1; design 3)") == {3, 5, 12}


def shared_names() -> dict[str, set[str]]:
    """Give the module names that several packages have, with those packages."""
    packages: dict[str, set[str]] = defaultdict(set)
    for path in SOURCE.rglob("*.py"):
        place = path.relative_to(SOURCE).parts
        if not path.stem.startswith("__"):
            packages[path.stem].add(place[0] if len(place) > 1 else "")
    return {name: where for name, where in packages.items() if len(where - COMMANDS_AND_STAGES) > 1}


def test_modules_of_one_name_mean_the_same_in_every_package():
    assert set(shared_names()) - set(SAME_ROLE) == set()


def test_the_version_is_that_of_the_changelog():
    headings = re.findall(r"^## \[([^]]+)\]", text_of("CHANGELOG.md"), re.MULTILINE)
    version = Version(ostiform.__version__)
    released = [Version(heading) for heading in headings if heading != "Unreleased"]
    if version.is_devrelease:
        assert headings[0] == "Unreleased"
        assert Version(version.base_version) > released[0]
    else:
        assert released[0] == version
    cited = re.search(r"^version: (\S+)$", text_of("CITATION.cff"), re.MULTILINE)
    assert cited is not None
    assert Version(cited[1]) == released[0]


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_everything_that_is_required_is_pinned_for_development_at_a_version_that_is_allowed():
    project = tomllib.loads(text_of("pyproject.toml"))
    groups = [
        *project["dependency-groups"].values(),
        *project["project"]["optional-dependencies"].values(),
        project["project"]["dependencies"],
    ]
    lines = [line for line in text_of("constraints.txt").splitlines() if not line.startswith("#")]
    pins = {canonicalize_name(Requirement(line).name): line.split("==")[1] for line in lines}
    for requirement in (Requirement(text) for group in groups for text in group):
        version = pins.get(canonicalize_name(requirement.name))
        assert version is not None, f"{requirement}: run `make constraints`"
        assert requirement.specifier.contains(version), f"{requirement}: run `make constraints`"
