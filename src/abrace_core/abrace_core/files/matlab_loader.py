# SPDX-License-Identifier: Apache-2.0
"""Loads a MATLAB file in a process of its own, because SciPy's reader crashes the process on some damaged files.

Run as a program with a path, it writes the variables, pickled, to standard output, or an error in one line to standard
error. The second argument is "new" for version 7.3, "as_stored", or empty.
"""

from __future__ import annotations

import importlib
import importlib.util
import pickle
import subprocess
import sys
import warnings
from typing import TYPE_CHECKING, Any

if __name__ != "__main__":
    from abrace_core import AbraceError
    from abrace_core.files.file_kinds import RECORDS, decoded

if TYPE_CHECKING:
    from pathlib import Path

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_LONGEST_REASON = 80


def load_matlab(path: Path, source: str, *, as_stored: bool = False) -> dict[str, Any]:
    """The variables of a MATLAB file at `path`, which errors call `source`; of version 7.3 with pymatreader.

    Structs are dicts, and arrays have no axes of length 1; `as_stored`: they have, and structs and cells are SciPy's.

    Raises
    ------
    OSError
        If there is none.
    AbraceError
        If it is something else, or damaged: which.
    """
    with path.open("rb") as file:
        start = file.read(520)
    is_new = start.startswith(b"MATLAB 7.3") or _HDF5_MAGIC in (start[:8], start[512:])
    if is_new and importlib.util.find_spec("pymatreader") is None:
        raise AbraceError(
            f"{source}: a MATLAB file of version 7.3 (HDF5), expected one saved with save -v7, or {RECORDS}"
        )
    if b"\0" not in start[:200] and start and not is_new:
        decoded(start, source)  # says what it is
        raise AbraceError(f"{source}: a text, expected a MATLAB file")
    # -P: SciPy's imports are not searched in the folder of this module
    ran = subprocess.run(
        [sys.executable, "-P", __file__, str(path), "new" if is_new else "as_stored" if as_stored else ""],
        capture_output=True,
        check=False,
    )
    if ran.returncode:
        reason = "damaged"  # where a signal ended it
        if ran.returncode > 0:
            reason = " ".join(ran.stderr.decode(errors="replace").split())[:_LONGEST_REASON]
        version = "7.3 (HDF5)" if is_new else "4 to 7.2"
        raise AbraceError(f"{source}: not read as a MATLAB file of version {version} ({reason})")
    variables: dict[str, Any] = pickle.loads(ran.stdout)
    return variables


def _main() -> int:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # "returned data may be corrupt"
            warnings.filterwarnings("ignore", "Duplicate variable name")  # objects, which are left out
            if sys.argv[2] == "new":
                variables = importlib.import_module("pymatreader").read_mat(sys.argv[1])
            else:
                from scipy.io import loadmat

                variables = loadmat(sys.argv[1], appendmat=False, simplify_cells=not sys.argv[2])
    except Exception as error:  # SciPy raises almost any exception for a file that is damaged or not MATLAB's
        print(str(error) or type(error).__name__, file=sys.stderr)
        return 1
    sys.stdout.buffer.write(pickle.dumps(variables))
    return 0


if __name__ == "__main__":
    sys.exit(_main())
