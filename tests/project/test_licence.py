# SPDX-License-Identifier: Apache-2.0
"""Every source file says its licence in its first lines, as programs read it (SPDX)."""

import re
import subprocess
from pathlib import Path

import pytest
from source_tree import ROOT

PATTERNS = (
    "*.py", "*.sh", "*.bash", "*.c", "*.h", "*.js", "*.css", "*.html", "*.xml", "*CMakeLists.txt", "Makefile", ".ci/*",
    "src/*/scripts/*",
)  # fmt: skip
NOT_OURS = re.compile(r".*/uPlot\..*")
"""Files of others, with their own licence beside them."""
STATED = re.compile(r".*package\.xml")
"""Files whose format has a key for the licence, which `tests/docs` compares."""
LINE = "SPDX-License-Identifier: Apache-2.0"


def test_every_source_file_names_the_licence():
    if not (ROOT / ".git").exists():
        pytest.skip("a copy without git's list of files")
    listed = subprocess.run(["git", "ls-files", *PATTERNS], cwd=ROOT, capture_output=True, text=True, check=True)
    names = [name for name in listed.stdout.split() if not NOT_OURS.fullmatch(name) and not STATED.fullmatch(name)]
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in names if (ROOT / name).exists()}
    assert len(texts) > 400
    kinds = {Path(name).suffix or Path(name).name for name in texts}
    assert {".js", ".css", ".html", ".xml", "run", "Makefile"} <= kinds
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    without = [name for name, text in texts.items() if text.strip() and LINE not in "".join(text.splitlines(True)[:3])]
    assert not without, f"{without}: expected '# {LINE}', as a comment, in the first lines"
