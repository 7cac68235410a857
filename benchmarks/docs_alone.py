# SPDX-License-Identifier: Apache-2.0
"""What a new user reaches from the pages alone: each is followed, block by block, after a whole `abrace demo`."""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from claims import Claim
from documents import PAGES, ROOT
from page_runner import SKIP, copied, follow, is_followed


def verify_docs() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    begin = time.monotonic()
    executed, compared, skipped = 0, 0, dict[str, str]()
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        demo = Path(name) / "demo"
        demo.mkdir()
        ended = subprocess.run(["abrace", "demo"], cwd=demo, check=True, capture_output=True, text=True)
        for page in filter(is_followed, PAGES):
            followed = follow(
                page, copied(demo, Path(name) / page.stem), SKIP.get(page.stem), {"abrace demo": ended.stdout}
            )
            compared += followed.compared
            executed += followed.executed
            skipped |= followed.skipped
            wrong += [f"{page.name}: {line}" for line in followed.wrong]
    pictures = [path for path in (ROOT / "docs/figures").iterdir() if path.suffix in (".png", ".svg", ".gif")]
    values = {
        "words": sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES),
        "blocks": executed + len(skipped),
        "executed": executed,
        "skipped": skipped,
        "compared": compared,
        "pictures": len(pictures),
        "seconds": time.monotonic() - begin,
    }
    if wrong:
        print("shown, but not printed:", *wrong, sep="\n")
    return values, [Claim("docs: lines shown that are not printed", len(wrong), 0, "-")]
