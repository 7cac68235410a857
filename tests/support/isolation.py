# SPDX-License-Identifier: Apache-2.0
"""A folder and a ROS domain of its own for what a benchmark starts, and nothing left of a process that it kills."""

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
    """Files of shared memory that the middleware of a process, by its number, leaves when it is killed.

    It has those of others open as well, who live on: its own are the ones that it holds locked.
    """
    opened = [str(entry.readlink()) for entry in Path(f"/proc/{process}/fd").iterdir()]
    locks = [name for name in opened if re.fullmatch(r"/dev/shm/fastrtps_[0-9a-f]{16}_el", name)]
    return [Path(name.removesuffix(ending)) for name in locks for ending in ("", "_el")]


@contextlib.contextmanager
def isolated() -> Iterator[Path]:
    """Work in a new folder and on a domain that nobody else on this machine uses; gives the folder from before."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, domain_id() as domain:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        os.chdir(folder)
        try:
            yield here
        finally:
            os.chdir(here)
