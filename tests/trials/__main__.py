"""Run all trials, and print a table of their outcomes: ``python -m trials --help``."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from trials.judge import GOOD
from trials.runner import run

__all__ = ["WHOLE"]

WHOLE = {"urdfs": 3_000, "scenarios": 1_500, "calls": 20_000, "kills": 200}
_COLUMNS = (*GOOD, "other error", "warning", "memory", "hang", "crash")


def main() -> int:
    """Run the trials; return 1 if a trial failed."""
    parser = argparse.ArgumentParser(
        prog="python -m trials", description="Try the library with damaged input."
    )
    parser.add_argument("kinds", nargs="*", help=f"some of {', '.join(WHOLE)}; default: all")
    parser.add_argument("--share", type=float, default=1.0, help="share of the full number of trials")
    parser.add_argument(
        "--first", type=int, default=0, help="seed of the first trial; the test suite begins with 0"
    )
    arguments = parser.parse_args()
    bad = 0
    print("| trials | number | " + " | ".join(_COLUMNS) + " | time [s] |")
    print("|---|" + "---|" * (len(_COLUMNS) + 2))
    for kind in arguments.kinds or WHOLE:
        count, began = max(1, round(arguments.share * WHOLE[kind])), time.monotonic()
        ended: Counter[str] = Counter()
        for verdict in run(kind, count, arguments.first):
            ended[verdict.outcome] += 1
            if verdict.outcome not in GOOD:
                bad += 1
                print(
                    f"{kind} {verdict.seed}: {verdict.outcome}: {verdict.what}: {verdict.detail}",
                    file=sys.stderr,
                )
        cells = " | ".join(str(ended[column]) for column in _COLUMNS)
        print(f"| {kind} | {count} | {cells} | {time.monotonic() - began:.0f} |", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
