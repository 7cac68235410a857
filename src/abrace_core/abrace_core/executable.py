# SPDX-License-Identifier: Apache-2.0
"""The entry point of every node's executable: `lib/PACKAGE/NAME` runs `main` of `PACKAGE.nodes.NAME`."""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import io
import os
import signal
import sys
from pathlib import Path

from abrace_core.errors import AbraceError
from abrace_core.ros_arguments import check_environment


def main() -> int:
    """Import the node's module, for which a second may pass, run it and end; returns 2 for a wrong environment."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # nothing is open yet; the default one prints where in which import it came
        signal.signal(number, lambda *_: os._exit(0))
    replace_unprintable()
    package, name = Path(sys.argv[0]).parts[-2:]
    try:
        check_environment()  # before ROS is imported, which ends the process where it cannot go on
    except AbraceError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        return 2
    gc.disable()  # modules stay: looking for garbage among their objects would take a tenth of the import's time
    module = importlib.import_module(f"{package}.nodes.{name}")
    gc.freeze()
    gc.enable()
    exit_code = int(module.main())
    _call_exit_handlers()
    os._exit(exit_code)  # without freeing the interpreter's objects one by one, for a quarter of a second


def replace_unprintable() -> None:
    """Print `?` for characters that the terminal's encoding does not have, as in ISO 8859-1, instead of an error."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def _call_exit_handlers() -> None:
    """Call the functions registered with `atexit`, and flush the output."""
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # the reader has left
            stream.flush()
