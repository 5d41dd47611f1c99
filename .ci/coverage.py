"""Write the share of lines that the tests run where the README tells it (`make coverage`)."""

import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"
TOLD = re.compile(r"(?<=<!-- coverage -->).*?(?=<!-- end -->)")


def main() -> None:
    """Combine what was measured, and write the figure."""
    coverage = [sys.executable, "-m", "coverage"]
    total = subprocess.run(
        [*coverage, "report", "--format=total", "--precision=1"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    text, found = TOLD.subn(
        f"The tests run {total} % of the lines of `src` ({datetime.now(UTC):%Y-%m-%d}).",
        README.read_text(encoding="utf-8"),
    )
    if found != 1:
        sys.exit(f"{README}: expected <!-- coverage --><!-- end --> once, found {found}")
    README.write_text(text, encoding="utf-8")
    print(f"{total} %")


if __name__ == "__main__":
    main()
