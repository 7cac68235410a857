# SPDX-License-Identifier: Apache-2.0
"""Architecture and CONTRIBUTING name files that exist."""

import re

from source_tree import ROOT

PLACEHOLDERS = {"NAME", "PACKAGE", "MODULE"}


def test_what_is_named_exists():
    files = [str(path.relative_to(ROOT)) for path in ROOT.glob("src/*/*/**/*") if "__pycache__" not in path.parts]
    for page in ("CONTRIBUTING.md", "docs/architecture.md"):
        for path in set(re.findall(r"`([\w./]+)`", (ROOT / page).read_text(encoding="utf-8"))):
            if ("/" in path or path.endswith(".py")) and not PLACEHOLDERS & set(re.findall(r"[A-Z]+", path)):
                assert (ROOT / path).exists() or any(file.endswith(f"/{path}") for file in files), path
    for path in re.findall(r"pytest (tests/[\w/.]+)", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")):
        assert (ROOT / path).exists(), path
