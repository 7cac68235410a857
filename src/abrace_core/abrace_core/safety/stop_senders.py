# SPDX-License-Identifier: Apache-2.0
"""The senders of a stop. The rig is stopped while any of them presses or, if required, a heartbeat is missing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable


MANY = 100
"""Senders from which on those that have released and fallen silent are dropped: programs that publish once."""
SILENCE = 60.0
"""Seconds without a message after which a sender counts as silent then."""
UNNAMED = "a node of unknown name"
"""A sender whose name is not known yet: the middleware reports it after the first message, or never."""


@dataclass
class _Sender:
    name: str
    number: int
    pressed: bool
    heard: float


class StopSenders:
    """The last message of each sender of a stop.

    Parameters
    ----------
    heartbeat
        Seconds within which each sender must repeat its message, and the first sender must appear; 0: off.
    now
        Present time [s].
    """

    def __init__(self, heartbeat: float, now: float) -> None:
        self._heartbeat = heartbeat
        self._senders: dict[Hashable, _Sender] = {}
        self._began = now

    def hear(self, sender: Hashable, name: str, number: int, pressed: bool, now: float) -> None:
        """Note message `number` of a `sender`, with its `name`, at `now` [s]: whether the stop is `pressed`.

        Messages come several times, by several subscriptions; one that is not newer than the last changes nothing.
        """
        known = self._senders.get(sender)
        if known is None and len(self._senders) >= MANY and not self._heartbeat:
            # neither of these is a stop; with a heartbeat, silence is one
            self._senders = {
                one: last for one, last in self._senders.items() if last.pressed or now - last.heard < SILENCE
            }
        if known is None or number > known.number:
            self._senders[sender] = _Sender(name, number, pressed, now)

    def name(self, sender: Hashable) -> str:
        """Name of a sender; empty: it has sent no message yet, or is UNNAMED."""
        known = self._senders[sender].name if sender in self._senders else ""
        return "" if known == UNNAMED else known

    def rename(self, sender: Hashable, name: str) -> None:
        """Set the `name` of a `sender`, which has become known after its first message."""
        self._senders[sender].name = name

    @property
    def unnamed(self) -> tuple[Hashable, ...]:
        """The senders that ask for a stop and are UNNAMED."""
        return tuple(sender for sender, one in self._senders.items() if one.pressed and one.name == UNNAMED)

    def pressed_by(self, now: float) -> str:
        """The senders that ask for a stop at `now` [s], as text; empty: none."""
        asking = [f"pressed by {one.name}" for one in self._senders.values() if one.pressed]
        if self._heartbeat:
            silent = [one.name for one in self._senders.values() if now - one.heard > self._heartbeat]
            asking += [f"no heartbeat of {name} for more than {self._heartbeat:g} s" for name in silent]
            if not self._senders and now - self._began > self._heartbeat:
                asking.append(f"no heartbeat for more than {self._heartbeat:g} s")
        return ", ".join(asking)

    def forget(self, gone: Iterable[Hashable], now: float) -> None:
        """Forget the senders that are `gone` and cannot release their stop; a person clears the stop at `now` [s].

        One that comes back, after its connection was lost, is heard again with its last message.
        """
        for sender in gone:
            self._senders.pop(sender, None)
        self._began = now

    @property
    def senders(self) -> tuple[Hashable, ...]:
        """All senders that are kept."""
        return tuple(self._senders)
