# SPDX-License-Identifier: Apache-2.0
"""Run the stages of the tests, whatever the ones before gave; run again by itself what failed; say what is known.

    python tests/runner [--strict] [STAGE ...]

A test that fails, and passes when its file is run in a fresh process with nothing beside it, is unsteady: it is named
with its first failure, and only --strict makes it a failure. Tests in tests/quarantine.txt are run and named, and
decide nothing. Writes results/tests.json, and each stage's output to results/tests/.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

# nothing is installed yet when the whole is run: abrace from its sources
sys.path.extend(str(Path(__file__).resolve().parents[2] / "src" / each) for each in ("abrace_core", "abrace_node"))

from outcomes import Report, read_quarantine
from processes import stop_when_asked
from stage_runner import Runner
from stages import STAGES, STEPS

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """Run the program; 0: all is well, 1: something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strict", action="store_true", help="an unsteady test is a failure")
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=f"out of: {', '.join(STAGES)}; default: all")
    given = parser.parse_args()
    if unknown := [name for name in given.stages if name not in STAGES]:
        parser.error(f"no stage {', '.join(unknown)}, expected some of: {', '.join(STAGES)}")
    os.chdir(ROOT)
    try:
        quarantine = read_quarantine(Path("tests/quarantine.txt"))
    except ValueError as error:
        parser.error(str(error))
    stop_when_asked()
    results = Path("results")
    runner = Runner(results / "tests", quarantine)
    runner.output.mkdir(parents=True, exist_ok=True)
    for old in runner.output.iterdir():
        old.unlink()
    chosen = [name for name in STAGES if name in given.stages or not given.stages]
    steps = [
        [[STAGES[name] for name in row if name in chosen] for row in step if set(row) & set(chosen)] for step in STEPS
    ]
    runner.run(step for step in steps if step)
    known = Report()
    for name in chosen:
        known.add(name, runner.seconds[name], runner.outcomes[name], quarantine)
    (results / "tests.json").write_text(known.json())
    print(known.text(given.strict))
    return 1 if known.failed or (given.strict and known.unsteady) else 0


if __name__ == "__main__":
    sys.exit(main())
