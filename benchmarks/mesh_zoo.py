"""Print what becomes of every flawed mesh of the zoo: flaw, outcome, message.

Run from the repository root: ``python benchmarks/mesh_zoo.py``.
"""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ostiform.errors import InputError  # noqa: E402
from ostiform.pipeline.check import check_study  # noqa: E402
from tests.oracles.mesh_zoo import ZOO, Specimen, study_of  # noqa: E402


def outcome(specimen: Specimen, folder: Path) -> tuple[str, str]:
    """Return what became of a specimen, in one word, and the sentences that say why."""
    try:
        checks = check_study(study_of(specimen, folder))
    except InputError as error:
        return "refused", str(error)
    problems = [check.problem for check in checks if check.problem]
    repairs = [repair for check in checks for repair in check.repairs]
    if problems:
        return "refused", "; ".join(problems)
    return ("repaired", "; ".join(repairs)) if repairs else ("usable", "")


def main() -> None:
    print("| flaw | outcome | message |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as scratch:
        for number, specimen in enumerate(ZOO):
            folder = Path(scratch) / str(number)
            found, message = outcome(specimen, folder)
            print(f"| {specimen.flaw} | {found} | {message.replace(f'{folder}/', '')} |")


if __name__ == "__main__":
    main()
