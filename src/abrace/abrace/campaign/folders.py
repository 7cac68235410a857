# SPDX-License-Identifier: Apache-2.0
"""The folders of a campaign's results and bags: results/NAME is always complete, results/_unfinished is in progress."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.files.writing import make_folder, move, write_text

if TYPE_CHECKING:
    from collections.abc import Iterator

RESULTS = Path("results")
BAGS = Path("bags")
PATIENCE = 30.0
"""Seconds within which the nodes of a killed campaign have to end."""


def unwritable() -> list[str]:
    """Why no campaign can write here, a text for each of the folders of results and bags that cannot be written."""
    found = []
    for folder in (RESULTS, BAGS):
        if folder.exists() and not folder.is_dir():
            found.append(f"{folder} in {Path.cwd()} is a file, expected a folder or nothing")
        elif not os.access(folder if folder.exists() else Path(), os.W_OK | os.X_OK):
            found.append(f"{folder} in {Path.cwd()} cannot be written, expected a folder where you may write")
    return found


class Folders:
    """The folders of the campaign `name`, below the working directory."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.results = RESULTS / name
        """Results of the last complete run."""
        self.unfinished = RESULTS / "_unfinished" / name
        """Results of the run in progress, or interrupted; no campaign has a name that begins with _."""
        self._replaced = RESULTS / f".{name}.replaced"

    @contextlib.contextmanager
    def locked(self) -> Iterator[int]:
        """Prevent other runs of the campaign; gives the lock, an open file: processes that inherit it hold it, too.

        Raises
        ------
        AbraceError
            If the campaign is already running.
        """
        make_folder(RESULTS)
        lock = os.open(RESULTS / f".{self.name}.lock", os.O_RDWR | os.O_CREAT, 0o666)
        try:
            self._take(lock)
            if not self.results.exists() and self._replaced.exists():
                move(self._replaced, self.results)  # killed in `swap_in`
            yield lock
        finally:
            os.close(lock)

    def _take(self, lock: int) -> None:
        deadline = time.monotonic() + PATIENCE
        waiting = False
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise AbraceError(
                        f"campaign {self.name}: another process is running it in this folder, expected one at a time"
                    ) from None
                if not waiting:
                    print(f"abrace: waiting until the last run of {self.name} has ended", file=sys.stderr, flush=True)
                    waiting = True
                time.sleep(0.05)
            else:
                return

    def new_bags(self) -> Path:
        """A folder for the bags of this run, which does not exist yet."""
        now = datetime.now().strftime("%Y%m%d-%H%M%S")
        folder, number = BAGS / self.name / now, 1
        while folder.exists():
            number += 1
            folder = BAGS / self.name / f"{now}-{number}"
        return folder

    def settle(self, step: str) -> None:
        """Change the paths in the parameter files of a `step` to those after `swap_in`, so that they can be reused."""
        for path in (self.unfinished / "nodes").glob(f"{step}_*.yaml"):
            self._settle(path)

    def settle_report(self) -> None:
        """Change the paths in the report to those after `swap_in`."""
        self._settle(self.unfinished / "report.html")

    def _settle(self, path: Path) -> None:
        text = path.read_text(encoding="utf-8")
        settled = text.replace(f"{self.unfinished}/", f"{self.results}/")
        if settled != text:
            write_text(path, settled)

    def swap_in(self) -> None:
        """Replace the last results by the unfinished ones, which are complete now."""
        shutil.rmtree(self._replaced, ignore_errors=True)
        if self.results.exists():
            move(self.results, self._replaced)
        move(self.unfinished, self.results)
        shutil.rmtree(self._replaced, ignore_errors=True)
        with contextlib.suppress(OSError):
            self.unfinished.parent.rmdir()
