# SPDX-License-Identifier: Apache-2.0
"""Shared memory that killed nodes have left: with a thousand of these files nodes by the clock miss many samples."""

from __future__ import annotations

import fcntl
import re
import time
from contextlib import suppress
from pathlib import Path

FOLDER = Path("/dev/shm")
SEGMENT_LOCK = re.compile(r"(fastrtps_[0-9a-f]{16})_el")
"""Of Fast DDS: the lock of a segment, which its node holds as long as it lives; then the segment's own name."""
YOUNG = 60.0
"""Seconds in which a lock may have been made, but not taken yet."""


def remove_stale_segments(folder: Path = FOLDER) -> None:
    """Remove the segments in a `folder` whose lock nobody holds, as `fastdds shm clean` does; not those of others."""
    latest = time.time() - YOUNG
    for lock in folder.glob("fastrtps_*_el"):
        if (name := SEGMENT_LOCK.fullmatch(lock.name)) is None:
            continue
        with suppress(OSError), lock.open("rb") as file:  # held, or of another user
            if lock.stat().st_mtime < latest:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                (folder / name[1]).unlink(missing_ok=True)
                lock.unlink()
