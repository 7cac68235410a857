# SPDX-License-Identifier: Apache-2.0
"""Every source file says its licence in its first lines, as programs read it (SPDX)."""

import subprocess

import pytest
from source_tree import ROOT

PATTERNS = ("*.py", "*.sh", "*.bash", "*.c")
LINE = "SPDX-License-Identifier: Apache-2.0"


def test_every_source_file_names_the_licence():
    if not (ROOT / ".git").exists():
        pytest.skip("a copy without git's list of files")
    listed = subprocess.run(["git", "ls-files", *PATTERNS], cwd=ROOT, capture_output=True, text=True, check=True)
    texts = {
        name: (ROOT / name).read_text(encoding="utf-8") for name in listed.stdout.split() if (ROOT / name).exists()
    }
    assert len(texts) > 400
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    without = [name for name, text in texts.items() if text.strip() and LINE not in "".join(text.splitlines(True)[:3])]
    assert not without, f"{without}: expected '# {LINE}' as the first line"
