"""``python -m tests.fuzz``: damaged files for every reader; exit code 0 if none failed."""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.fuzz.campaign import Tally, case_content, run_apart
from tests.fuzz.targets import make_targets


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=1000, help="cases per reader")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", nargs="+", help="readers; all by default")
    parser.add_argument("--show", type=Path, help="write the file of the first case here, and end")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        targets = make_targets(Path(folder, "sound"))
        chosen = options.only or list(targets)
        if unknown := sorted(set(chosen) - set(targets)):
            print(f"unknown: {', '.join(unknown)}; known: {', '.join(targets)}", file=sys.stderr)
            return 2
        if options.show:
            options.show.write_bytes(case_content(targets[chosen[0]], options.first))
            return 0
        cases = range(options.first, options.first + options.cases)
        tally = run_apart(chosen, cases, Path(folder))
    show(tally, chosen)
    return 1 if tally.findings else 0


def show(tally: Tally, names: list[str]) -> None:
    print(f"{'reader':24s} {'read':>8s} {'refused':>8s} {'failed':>8s}")
    for name in names:
        counts = [tally.outcomes[name, outcome] for outcome in ("read", "refused", "failed")]
        print(f"{name:24s} {counts[0]:8d} {counts[1]:8d} {counts[2]:8d}")
    print(f"{tally.outcomes.total()} files, {len(tally.findings)} failed")
    seen: Counter[tuple[str, str]] = Counter()
    for finding in tally.findings:
        seen[finding.target, finding.what] += 1
        if seen[finding.target, finding.what] == 1:
            print(f"\n{finding.target}, case {finding.case}: {finding.what}\n{finding.detail}")
    for (target, what), count in seen.items():
        print(f"{count} x {target}: {what}")


if __name__ == "__main__":
    sys.exit(main())
