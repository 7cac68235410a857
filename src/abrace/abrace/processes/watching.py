# SPDX-License-Identifier: Apache-2.0
"""Starting the viewer of a campaign or a bag: a page in the browser that shows the building in motion."""

from __future__ import annotations

import os
import re
import sys
import tempfile
import time
import webbrowser
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.processes.group import ProcessGroup, find_executable
from abrace_core.errors import RunFailed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace.processes.group import NodeProcess

VIEWER = "abrace_bringup/viewer"
"""Package and executable, in the layer above this package: it is looked up when it is started, never imported."""
PATIENCE = 30.0
"""Seconds within which the viewer has to accept connections."""
POLL = 0.1
"""Seconds between checks of the viewer's output."""
_LISTENS = re.compile(r"^viewer: (\S+) in a browser.*:(\d+)$", re.MULTILINE)


@contextmanager
def watched(rig_file: Path, parameters: Sequence[str] = ()) -> Iterator[None]:
    """Show the running graph on a page within the block; opens a browser if this machine has a desktop.

    Parameters
    ----------
    rig_file
        File of the rig to draw.
    parameters
        Further parameters of the viewer, each as name:=value.

    Raises
    ------
    RunFailed
        If the viewer does not start.
    """
    with _viewer(f"rig:={rig_file.resolve()}", *parameters) as (url, _):
        desktop = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        opened = bool(desktop) and webbrowser.open(url)
        print(f"watch: {url}{'' if opened else ' (open it in a browser on this machine)'}", file=sys.stderr, flush=True)
        yield


def watch_bag(bag: Path) -> None:
    """Play a `bag` on the page in real time, in a loop until Ctrl-C.

    Raises
    ------
    RunFailed
        If the viewer does not start, or ends by itself.
    """
    with _viewer(f"bag:={bag.resolve()}") as (url, group):
        print(f"watch: {url} plays {bag} in real time; Ctrl-C ends it", file=sys.stderr, flush=True)
        with suppress(KeyboardInterrupt):
            while True:
                group.raise_if_died()
                time.sleep(POLL)


@contextmanager
def _viewer(*parameters: str) -> Iterator[tuple[str, ProcessGroup]]:
    """Start a viewer with `parameters`; gives the URL of its page, and the group with its process."""
    package, executable = VIEWER.split("/")
    command: list[str | Path] = [find_executable(package, executable), "--ros-args"]
    command += [word for parameter in parameters for word in ("-p", parameter)]
    with tempfile.TemporaryDirectory() as folder, ProcessGroup() as group:
        viewer = group.start(executable, command, Path(folder) / "viewer.log")
        yield _listening(viewer), group


def _listening(viewer: NodeProcess) -> str:
    """Wait until the viewer accepts connections; returns the URL of its page."""
    deadline = time.monotonic() + PATIENCE
    while not (found := _LISTENS.search(viewer.log_file.read_text(encoding="utf-8", errors="replace"))):
        if viewer.returncode is not None:
            raise viewer.died()
        if time.monotonic() > deadline:
            raise RunFailed(f"the viewer did not start within {PATIENCE:g} s")
        time.sleep(POLL)
    return found[1]
