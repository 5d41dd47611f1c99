"""Print what pip would install for developing, an exact version a line (`make constraints`).

Nothing is installed: pip resolves the groups and reports. To be run by the oldest Python that is
supported, since a release that still runs there runs on the later ones too.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

GROUPS = ("test", "lint", "docs", "benchmarks", "browser", "commit")
EXTRAS = "dask,plot"
OLDEST = (3, 11)


def main() -> None:
    """Resolve, and print the constraints."""
    if sys.version_info[:2] != OLDEST:
        sys.exit(f"constraints: expected Python {OLDEST[0]}.{OLDEST[1]}, found {sys.version}")
    groups = [word for group in GROUPS for word in ("--group", group)]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        install = ["install", "--dry-run", "--ignore-installed", "--quiet", "--report", str(report)]
        subprocess.run([sys.executable, "-m", "pip", *install, f".[{EXTRAS}]", *groups], check=True)
        found = json.loads(report.read_text(encoding="utf-8"))["install"]
    pins = {item["metadata"]["name"].lower(): item["metadata"]["version"] for item in found}
    print("# Made by `make constraints` on Python 3.11; holds for Python 3.11 to 3.14.")
    for name in sorted(pins.keys() - {"ostiform"}):
        print(f"{name}=={pins[name]}")


if __name__ == "__main__":
    main()
