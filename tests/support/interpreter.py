# SPDX-License-Identifier: Apache-2.0
"""Whether code keeps Python's interpreter to itself while it runs."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

LONG = 100.0
"""Seconds after which a thread would have to yield."""


def yields(act: Callable[[], object], count: int = 100) -> int:
    """How often `act`, called `count` times, has let another thread have the interpreter."""
    turns, over = 0, False

    def take_turns() -> None:
        nonlocal turns
        while not over:
            turns += 1
            time.sleep(0.0)

    usual = sys.getswitchinterval()
    sys.setswitchinterval(LONG)
    thread = threading.Thread(target=take_turns)
    thread.start()
    try:
        while turns < 3:  # it waits for the interpreter now, without a pause
            time.sleep(0.001)
        before = turns
        for _ in range(count):
            act()
        return turns - before
    finally:
        over = True
        sys.setswitchinterval(usual)
        thread.join()
