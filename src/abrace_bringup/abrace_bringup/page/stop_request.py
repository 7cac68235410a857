# SPDX-License-Identifier: Apache-2.0
"""Whether the page requests a stop, and why: a person pressed, or a page was lost that has to stay."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Hashable

NO_PAGE = "no page has been opened yet"


class StopRequest:
    """Stands until a person releases it on a page. Every method may be called from any thread.

    Parameters
    ----------
    heartbeat
        Seconds within which each open page has to answer, and within which a first page has to be opened: otherwise
        a stop is requested. 0: pages may come and go.
    """

    def __init__(self, heartbeat: float) -> None:
        self._heartbeat = heartbeat
        self._heard: dict[Hashable, float] = {}
        self._reason = NO_PAGE if heartbeat else ""
        self._lock = threading.Lock()

    def press(self, reason: str) -> None:
        """Ask for a stop, for this `reason`; the first one stays."""
        with self._lock:
            self._reason = self._reason or reason

    def release(self) -> None:
        """A person releases it.

        Raises
        ------
        AbraceError
            If no page has answered, although there has to be one.
        """
        with self._lock:
            if self._heartbeat and not self._heard:
                raise AbraceError("no page answers, expected an open page")
            self._reason = ""

    def hear(self, page: Hashable, now: float) -> None:
        """A `page` has shown at `now` [s] that it is there."""
        with self._lock:
            self._heard[page] = now

    def lose(self, page: Hashable) -> None:
        """A `page` has been closed, or its connection is lost."""
        with self._lock:
            if self._heard.pop(page, None) is not None and self._heartbeat:
                self._reason = self._reason or "a page was closed, or its connection is lost"

    def reason(self, now: float) -> str:
        """Why a stop is requested at `now` [s]; empty: it is not."""
        with self._lock:
            if self._heartbeat and not self._reason:
                oldest = min(self._heard.values(), default=-float("inf"))
                if now - oldest > self._heartbeat:
                    self._reason = f"a page has not answered for more than {self._heartbeat:g} s"
            return self._reason
