"""A folder and a ROS domain of its own for what a benchmark starts."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from domain_coordinator import domain_id

if TYPE_CHECKING:
    from collections.abc import Iterator


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
