"""Who asks for a stop: stopped while any sender says so, and, where a heartbeat is asked for, while one is silent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable


UNNAMED = "a node of unknown name"
"""A sender whose name has not been heard yet: the middleware tells it after the first message, or never."""


@dataclass
class _Sender:
    name: str
    pressed: bool
    heard: float


class StopSenders:
    """What each sender of a stop has said last.

    Parameters
    ----------
    heartbeat
        Seconds within which each sender repeats itself, and within which there has to be one; 0: none has to.
    now
        Present time [s].
    """

    def __init__(self, heartbeat: float, now: float) -> None:
        self._heartbeat = heartbeat
        self._senders: dict[Hashable, _Sender] = {}
        self._began = now

    def hear(self, sender: Hashable, name: str, pressed: bool, now: float) -> None:
        """A `sender` of this `name` says, at `now` [s], whether its button is `pressed`."""
        self._senders[sender] = _Sender(name, pressed, now)

    def name(self, sender: Hashable) -> str:
        """Name of a sender that has been heard; empty: it has not, or is UNNAMED."""
        known = self._senders[sender].name if sender in self._senders else ""
        return "" if known == UNNAMED else known

    def rename(self, sender: Hashable, name: str) -> None:
        """The `name` of a `sender` that has been heard has become known."""
        self._senders[sender].name = name

    @property
    def unnamed(self) -> tuple[Hashable, ...]:
        """Those that ask for a stop and are UNNAMED."""
        return tuple(sender for sender, one in self._senders.items() if one.pressed and one.name == UNNAMED)

    def who(self, now: float) -> str:
        """Who asks for a stop at `now` [s]; empty: nobody."""
        asking = [f"pressed by {one.name}" for one in self._senders.values() if one.pressed]
        if self._heartbeat:
            silent = [one.name for one in self._senders.values() if now - one.heard > self._heartbeat]
            asking += [f"no heartbeat of {name} for more than {self._heartbeat:g} s" for name in silent]
            if not self._senders and now - self._began > self._heartbeat:
                asking.append(f"no heartbeat for more than {self._heartbeat:g} s")
        return ", ".join(asking)

    def forget(self, gone: Iterable[Hashable], now: float) -> None:
        """A person clears, at `now` [s]: senders that are `gone`, and can release nothing, do not count any more."""
        for sender in gone:
            self._senders.pop(sender, None)
        self._began = now

    @property
    def senders(self) -> tuple[Hashable, ...]:
        """All that have been heard."""
        return tuple(self._senders)
