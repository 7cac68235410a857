# SPDX-License-Identifier: Apache-2.0
"""Linear algebra in one thread: for matrices as small as a structure's, several threads wait for each other."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def one_thread() -> Iterator[None]:
    """As a context or a decorator: NumPy and SciPy use one thread within it, and as many as before afterwards.

    With OpenBLAS's default, a thread for each processor, identification takes 2.4 times as long on two processors, and
    five times the computing time.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
