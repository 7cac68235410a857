# SPDX-License-Identifier: Apache-2.0
"""A campaign or a bag on the page in the browser, which only watches then."""

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
from abrace_core import RunFailed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace.processes.group import NodeProcess

PAGE = "abrace_bringup/operator"
"""Package and executable, in the layer above this package: it is looked up when it is started, never imported."""
PLAYED = "/watched_bag"
"""The namespace in which a bag's samples are played: no rig's, so nothing that runs takes them for its own."""
PATIENCE = 30.0
"""Seconds within which the page has to be served."""
POLL = 0.1
"""Seconds between checks of the processes."""
_SERVES = re.compile(r"^operator: the page is (\S+)$", re.MULTILINE)


@contextmanager
def watched(namespace: str, rig_file: Path, parameters: Sequence[str] = ()) -> Iterator[None]:
    """Show the rig of a `namespace` and `rig_file` on a page within the block.

    Opens a browser if this machine has a desktop. `parameters`: further ones of the page's node, each as name:=value.

    Raises
    ------
    RunFailed
        If the page cannot be served.
    """
    with _page(namespace, rig_file, parameters) as (url, _):
        desktop = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        opened = bool(desktop) and webbrowser.open(url)
        print(f"watch: {url}{'' if opened else ' (open it in a browser on this machine)'}", file=sys.stderr, flush=True)
        yield


def watch_bag(bag: Path, namespace: str, rig_file: Path, parameters: Sequence[str] = ()) -> None:
    """Play a `bag` of a rig that ran in the `namespace` on the page in real time, again and again until Ctrl-C.

    `rig_file`, `parameters` as for `watched`.

    Raises
    ------
    RunFailed
        If the page cannot be served, or a process ends by itself.
    """
    topic = f"{namespace}/response"
    given = ("-p", f"bag:={bag.resolve()}", "-p", f"topics:=[{topic}]")
    remapped = ("-r", f"{topic}:={PLAYED}/response")
    command: list[str | Path] = [find_executable("abrace_bags", "replay"), "--ros-args", *given, *remapped]
    with tempfile.TemporaryDirectory() as folder, _page(PLAYED, rig_file, parameters) as (url, group):
        print(f"watch: {url} plays {bag} in real time; Ctrl-C ends it", file=sys.stderr, flush=True)
        with suppress(KeyboardInterrupt):
            while True:
                replay = group.start("replay", command, Path(folder) / "replay.log")
                while replay.returncode is None:
                    group.raise_if_died(may_finish=["replay"])
                    time.sleep(POLL)
                group.raise_if_died(may_finish=["replay"])
                group.stop("replay")


@contextmanager
def _page(namespace: str, rig_file: Path, parameters: Sequence[str]) -> Iterator[tuple[str, ProcessGroup]]:
    """Serve the page; gives its URL, and the group with its process."""
    package, executable = PAGE.split("/")
    given = (f"rig:={rig_file.resolve()}", "operate:=false", *parameters)
    command: list[str | Path] = [find_executable(package, executable), "--ros-args", "-r", f"__ns:={namespace}"]
    command += [word for parameter in given for word in ("-p", parameter)]
    with tempfile.TemporaryDirectory() as folder, ProcessGroup() as group:
        page = group.start(executable, command, Path(folder) / "page.log")
        yield _served(page), group


def _served(page: NodeProcess) -> str:
    """Wait until the page is served; returns its URL."""
    deadline = time.monotonic() + PATIENCE
    while not (found := _SERVES.search(page.log_file.read_text(encoding="utf-8", errors="replace"))):
        if page.returncode is not None:
            raise page.died()
        if time.monotonic() > deadline:
            raise RunFailed(f"the page was not served within {PATIENCE:g} s")
        time.sleep(POLL)
    return found[1]
