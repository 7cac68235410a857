# SPDX-License-Identifier: Apache-2.0
"""The report of the demo: how long `abrace report` takes, how large its page is, how soon a browser has drawn it."""

from __future__ import annotations

import statistics
import subprocess
import time
from pathlib import Path
from typing import Any

from browser import CHROMIUM
from driven_browser import DrivenBrowser

from abrace.campaign.course import run_campaign
from abrace_core.files.installed import find_file

DEMO = Path("results/demo")
WHOLE = ("origin.json", "timing.json", "comparison/comparison.json")
"""Files of a demo that was carried out."""
OPENED = 3
"""Times that the page is opened; the median counts."""


def report_speed() -> dict[str, Any]:
    """Seconds and megabytes of the demo's report, which is run where it has not been yet; seconds to draw it."""
    if not all((DEMO / name).exists() for name in WHOLE):
        run_campaign(find_file("demo", "abrace", "campaigns", ".yaml", "campaign"))
    begin = time.perf_counter()
    subprocess.run(["abrace", "report", DEMO], check=True, capture_output=True)
    seconds = time.perf_counter() - begin
    page = DEMO / "report.html"
    found: dict[str, Any] = {"seconds": seconds, "megabytes": page.stat().st_size / 1e6, "browser_seconds": None}
    if CHROMIUM is not None:
        with DrivenBrowser() as browser:
            drawn = [_drawn(browser, page) for _ in range(OPENED)]
        found |= {"browser_seconds": statistics.median(took for took, _ in drawn), "figures": drawn[0][1]}
    return found


def _drawn(browser: DrivenBrowser, page: Path) -> tuple[float, int]:
    """Seconds from opening the page until its last figure is drawn, and how many there are."""
    begin = time.perf_counter()
    tab = browser.open(page.resolve().as_uri())
    figures = tab.until("document.documentElement?.dataset.drawn")
    seconds = time.perf_counter() - begin
    assert not tab.errors, tab.errors
    tab.close()
    return seconds, int(figures)


def report_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of speeds, from what `report_speed` has `found`."""
    rows: list[tuple[str, ...]] = [
        ("report of the demo, s", f"{found['seconds']:.1f}", "10", "-", "-"),
        ("its page, MB", f"{found['megabytes']:.1f}", "5", "-", "-"),
    ]
    if found["browser_seconds"] is not None:
        title = f"opened in a browser and {found['figures']} figures drawn, s"
        rows.append((title, f"{found['browser_seconds']:.1f}", "3", "-", "-"))
    return rows
