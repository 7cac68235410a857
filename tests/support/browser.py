# SPDX-License-Identifier: Apache-2.0
"""Opens a page in headless Chromium: its content, its console messages, and its print."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""The browser of this machine; None: not installed."""
PATIENCE_MS = 30_000
"""Limit of the page's virtual time, which advances while the page is idle [ms]."""


@dataclass(frozen=True)
class Opened:
    """A page that was opened.

    Parameters
    ----------
    content
        Its HTML after everything was drawn.
    console
        Lines of its console, errors included.
    """

    content: str
    console: list[str]

    @property
    def drawn(self) -> dict[str, int]:
        """Number of curves, points and images in each figure, by the name of its element."""
        places = re.split(r'<div data-figure="', self.content)[1:]
        marks = r'<path class="(?:js-line|point)|<img '
        return {place.partition('"')[0]: len(re.findall(marks, place)) for place in places}


def open_page(path: Path) -> Opened:
    """Open the page in a file and wait until it is idle."""
    done = _chromium(path, "--dump-dom", "--enable-logging=stderr")
    return Opened(done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line])


def printed_pages(path: Path, pdf: Path) -> int:
    """Print the page in a file to a `pdf`; returns the number of sheets."""
    _chromium(path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer")
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", pdf.read_bytes()))


def _chromium(path: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert CHROMIUM is not None, "no Chromium on this machine"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}"]
        command += [f"--virtual-time-budget={PATIENCE_MS}", *options, path.resolve().as_uri()]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
