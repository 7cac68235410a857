# SPDX-License-Identifier: Apache-2.0
"""MATLAB files are read by a fork of the tests' process, without the half second in which a new one imports SciPy."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import multiprocessing
import subprocess
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import scipy.io  # noqa: F401 (so that the forks have it)

from abrace_core.files import matlab_loader

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection


def _read(words: list[str], answer: Connection) -> None:
    faulthandler.disable()  # a crash is an answer
    sys.argv, sys.stdout, sys.stderr = words, io.TextIOWrapper(io.BytesIO()), io.StringIO()
    code = matlab_loader._main()
    answer.send((code, sys.stdout.buffer.getvalue(), sys.stderr.getvalue().encode()))


def _run(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
    fork = multiprocessing.get_context("fork")
    receiving, sending = fork.Pipe(duplex=False)
    process = fork.Process(target=_read, args=(command[2:], sending))
    process.start()
    sending.close()
    found: Any = (-1, b"", b"")
    with contextlib.suppress(EOFError):  # a signal has ended it
        found = receiving.recv()
    process.join()
    return subprocess.CompletedProcess(command, *found)


@pytest.fixture(autouse=True, scope="module")
def matlab_files_by_forks() -> Iterator[None]:
    """For a module that imports this fixture."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matlab_loader, "subprocess", SimpleNamespace(run=_run))
        yield
