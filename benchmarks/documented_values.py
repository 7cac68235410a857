# SPDX-License-Identifier: Apache-2.0
"""Every documented value of every verb's options, run to a result: the part `documented` of `make verify`."""

from __future__ import annotations

import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

from claims import Claim
from documented import ELSEWHERE, RUNS, Data, covered, documented, result


def verify_documented() -> tuple[dict[str, Any], list[Claim]]:
    """Numbers of documented values, and of those that a run gave a result."""
    wanted = {
        verb: {each for each in documented(options) if (verb, each[0]) not in ELSEWHERE}
        for verb, (options, _) in RUNS.items()
    }
    ran: dict[str, set[tuple[str, str]]] = {verb: set() for verb in RUNS}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = Data(Path(folder))
        for verb, (options, runs) in RUNS.items():
            for number, run in enumerate(runs):
                try:
                    result(verb, run, data, number)
                except Exception:
                    traceback.print_exc()
                else:
                    ran[verb] |= covered(options, run)
    counts = {verb: (len(wanted[verb]), len(wanted[verb] & ran[verb])) for verb in RUNS}
    wanted_in_all, ran_in_all = (sum(each) for each in zip(*counts.values(), strict=True))
    values = {
        "values": wanted_in_all,
        "ran": ran_in_all,
        "verbs": {verb: {"values": count, "ran": of_runs} for verb, (count, of_runs) in counts.items()},
    }
    return values, [Claim("documented values that run to a result", ran_in_all, wanted_in_all, "", least=True)]
