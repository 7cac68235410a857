# SPDX-License-Identifier: Apache-2.0
"""Loads a MATLAB file in a process of its own, because SciPy's reader crashes the process on some damaged files.

Run as a program with a path, it writes the variables, pickled, to standard output, or an error in one line to standard
error.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from typing import TYPE_CHECKING, Any

from scipy.io import loadmat

if TYPE_CHECKING:
    from pathlib import Path

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_LONGEST_REASON = 80


def load_matlab(path: Path) -> dict[str, Any]:
    """The variables of a MATLAB file of version 4 to 7.2 at `path`, structs as dicts.

    Raises
    ------
    OSError
        If there is none.
    ValueError
        If it is something else, or damaged: which.
    """
    with path.open("rb") as file:
        start = file.read(520)
    if start.startswith(b"MATLAB 7.3") or _HDF5_MAGIC in (start[:8], start[512:]):
        raise ValueError("a MATLAB file of version 7.3 (HDF5), expected one saved with save -v7")
    # -P: SciPy's imports are not searched in the folder of this module
    ran = subprocess.run([sys.executable, "-P", __file__, str(path)], capture_output=True, check=False)
    if ran.returncode:
        reason = "damaged"  # where a signal ended it
        if ran.returncode > 0:
            reason = " ".join(ran.stderr.decode(errors="replace").split())[:_LONGEST_REASON]
        raise ValueError(f"not read as a MATLAB file of version 4 to 7.2 ({reason})")
    variables: dict[str, Any] = pickle.loads(ran.stdout)
    return variables


def _main() -> int:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # "returned data may be corrupt"
            variables = loadmat(sys.argv[1], appendmat=False, simplify_cells=True)
    except Exception as error:  # SciPy raises almost any exception for a file that is damaged or not MATLAB's
        print(str(error) or type(error).__name__, file=sys.stderr)
        return 1
    sys.stdout.buffer.write(pickle.dumps(variables))
    return 0


if __name__ == "__main__":
    sys.exit(_main())
