# SPDX-License-Identifier: Apache-2.0
"""The entry point of every node's executable: `lib/PACKAGE/NAME` runs `main` of `PACKAGE.nodes.NAME`."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from pathlib import Path

from abrace_core.errors import AbraceError
from abrace_core.ros_arguments import check_environment


def main() -> int:
    """Import the node's module, for which a second may pass, and run it; returns the exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # nothing is open yet; the default one prints where in which import it came
        signal.signal(number, lambda *_: os._exit(0))
    package, name = Path(sys.argv[0]).parts[-2:]
    try:
        check_environment()  # before ROS is imported, which ends the process where it cannot go on
    except AbraceError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        return 2
    return int(importlib.import_module(f"{package}.nodes.{name}").main())
