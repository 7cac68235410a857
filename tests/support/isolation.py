# SPDX-License-Identifier: Apache-2.0
"""Isolates a benchmark: a folder and a ROS domain of its own, and removal of the shared memory of killed processes."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from domain_coordinator import domain_id

if TYPE_CHECKING:
    from collections.abc import Iterator


def own_shared_memory(process: int) -> list[Path]:
    """Shared memory files of a process's middleware, which remain when the process, given by its number, is killed.

    The process also has files of other, living processes open: its own are those that it has locked.
    """
    opened = [str(entry.readlink()) for entry in Path(f"/proc/{process}/fd").iterdir()]
    locks = [name for name in opened if re.fullmatch(r"/dev/shm/fastrtps_[0-9a-f]{16}_el", name)]
    return [Path(name.removesuffix(ending)) for name in locks for ending in ("", "_el")]


@contextlib.contextmanager
def isolated() -> Iterator[Path]:
    """Work in a new folder and on a domain that no other process of this machine uses; gives the previous folder."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, domain_id() as domain:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        os.chdir(folder)
        try:
            yield here
        finally:
            os.chdir(here)
