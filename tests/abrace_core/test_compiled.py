# SPDX-License-Identifier: Apache-2.0
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from abrace_core.model.compiled import compiled

LOOP = """
import sys
import numpy as np
from abrace_core.model.compiled import compiled

@compiled
def leaky_sum(values, keep):
    total = 0.0
    for value in values:
        total = keep * total + value
    return total

if __name__ == "__main__":
    print(leaky_sum(np.arange(5.0), 0.5))
"""
EXPECTED = "6.125"


@compiled
def leaky_sum(values: np.ndarray, keep: float) -> float:
    """Sum that forgets."""
    total = 0.0
    for value in values:
        total = keep * total + value
    return total


def start(folder: Path, code: str = "import runpy; runpy.run_path('loop.py', run_name='__main__')", **environment: str):
    """A Python process of its own in `folder`, which holds LOOP as loop.py."""
    (folder / "loop.py").write_text(LOOP)
    kept = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env=kept | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def printed(process: subprocess.Popen) -> str:
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    assert errors == "", "no warning was expected"
    return output.strip()


def test_result_is_that_of_the_plain_function_and_names_stay():
    values = np.arange(5.0)
    assert leaky_sum(values, 0.5) == leaky_sum.__wrapped__(values, 0.5) == 6.125
    assert leaky_sum(values=values, keep=0.0) == 4.0
    assert (leaky_sum.__name__, leaky_sum.__doc__) == ("leaky_sum", "Sum that forgets.")


def test_nothing_is_imported_or_compiled_before_the_first_call(tmp_path):
    code = "import sys, loop; print('numba' in sys.modules)"
    assert printed(start(tmp_path, code)) == "False"


def test_processes_that_compile_at_once_leave_a_result_that_the_next_one_reads(tmp_path):
    assert [printed(process) for process in [start(tmp_path) for _ in range(2)]] == [EXPECTED] * 2
    (index,) = (tmp_path / "__pycache__").glob("loop.leaky_sum*.nbi")
    before = index.stat().st_mtime_ns
    assert list((tmp_path / "__pycache__").glob("loop.leaky_sum*.nbc"))
    code = "import runpy; runpy.run_path('loop.py', run_name='__main__')"
    # the source is not written again: its time tells numba whether the result still holds
    again = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert again.stdout.strip() == EXPECTED
    assert index.stat().st_mtime_ns == before, "the next process compiled again"


def test_folder_that_cannot_be_written_costs_the_cache_alone(tmp_path):
    # files where numba would make its folders: nobody, root included, can write below them
    (tmp_path / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    home = str(tmp_path / "home")
    assert printed(start(tmp_path, HOME=home, XDG_CACHE_HOME=home, PYTHONDONTWRITEBYTECODE="1")) == EXPECTED
