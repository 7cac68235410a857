# SPDX-License-Identifier: Apache-2.0
"""The `abrace` command as a program: how it begins and ends."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2] / "src/abrace"
SCRIPT, PROGRAM = ROOT / "scripts/abrace", ROOT / "abrace/__main__.py"
INTERRUPTED = """
import os, signal, time
{before}
def main():
    {within}
    return 0
"""
INTERRUPT = "os.kill(os.getpid(), signal.SIGINT); time.sleep(9.0)"


def ended(folder: Path, before: str, within: str) -> tuple[int, str]:
    (folder / "abrace").mkdir()
    (folder / "abrace/__init__.py").write_text("")
    shutil.copy(PROGRAM, folder / "abrace")
    (folder / "abrace/cli.py").write_text(INTERRUPTED.format(before=before, within=within))
    environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{os.environ['PYTHONPATH']}"}
    ran = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True, check=False, env=environment)
    return ran.returncode, ran.stderr


def test_a_signal_during_the_imports_prints_nothing(tmp_path: Path) -> None:
    assert ended(tmp_path, INTERRUPT, "pass") == (130, "")


def test_a_signal_after_them_is_the_commands(tmp_path: Path) -> None:
    code, errors = ended(tmp_path, "", f"\n    try: {INTERRUPT}\n    except KeyboardInterrupt: return 7")
    assert (code, errors) == (7, "")
