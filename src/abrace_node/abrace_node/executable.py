# SPDX-License-Identifier: Apache-2.0
"""The entry point of every node's executable: `lib/PACKAGE/NAME` runs `main` of `PACKAGE.nodes.NAME`."""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import io
import os
import re
import signal
import sys
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

from abrace_core import AbraceError
from abrace_core.files.suggestion import did_you_mean

GREATEST_DOMAIN = 232
NO_ROS = "no ROS 2 here (AMENT_PREFIX_PATH is not set), expected `source ros2_ws/setup.bash` after `make setup`"
JAZZY = "jazzy"
LOG_FOLDERS = ("ROS_LOG_DIR", "ROS_HOME", "HOME")
"""Variables of which ROS takes the first that is set for the folder of its logs."""
RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


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
    return leave(int(module.main()))


def replace_unprintable() -> None:
    """Print `?` for characters that the terminal's encoding does not have, as in ISO 8859-1, instead of an error."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def leave(exit_code: int) -> NoReturn:
    """End the process: call the functions registered with `atexit`, flush the output, and no more.

    The interpreter's objects are not freed one by one, for a quarter of a second, and libraries not ended: Fast DDS
    would wait for a participant that does not end (`transport.LEAVE_TIMEOUT`).
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # the reader has left
            stream.flush()
    os._exit(exit_code)


def check_environment() -> None:
    """Check the variables that ROS reads before a program can say anything; warn of a distribution other than Jazzy.

    Raises
    ------
    AbraceError
        `<variable>=<value>, expected ...`.
    """
    prefixes = [Path(text) for text in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if text]
    if not prefixes:
        raise AbraceError(NO_ROS)
    _expect("ROS_DOMAIN_ID", lambda text: text.isdecimal() and int(text) <= GREATEST_DOMAIN, "0 to 232")
    made = {
        path.name
        for each in prefixes
        for path in (each / "share/ament_index/resource_index/rmw_typesupport").glob("rmw_fastrtps_*")
    }
    _warn_of(os.environ.get("ROS_DISTRO") or JAZZY)
    # others number the messages of a stop button differently, or not at all: `StopListener` would not hear it
    _expect("RMW_IMPLEMENTATION", made.__contains__, f"Fast DDS: {', '.join(sorted(made))}")
    _expect("ROS_AUTOMATIC_DISCOVERY_RANGE", RANGES.__contains__, " or ".join(RANGES))
    if not any(os.environ.get(name) for name in LOG_FOLDERS):
        raise AbraceError("HOME is not set, as for a service: set HOME or ROS_LOG_DIR, the folder of ROS's logs")
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        _expect(name, lambda text: Path(text).is_file(), "a file")


@cache
def _warn_of(distribution: str) -> None:
    if distribution != JAZZY:
        print(f"ROS_DISTRO={distribution}: abrace was tried with {JAZZY} alone", file=sys.stderr, flush=True)


def _expect(name: str, fits: Any, expected: str) -> None:
    text = os.environ.get(name)
    if text and not fits(text):
        near = did_you_mean(text, re.findall(r"\w{4,}", expected))
        raise AbraceError(f"{name}={text}, expected {expected}{near}")
