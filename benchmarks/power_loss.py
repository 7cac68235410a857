# SPDX-License-Identifier: Apache-2.0
"""What a power loss leaves: everything that a real process does to a folder is recorded, then the disk is made again.

`power_loss.c`, compiled here and preloaded, logs the process's writes, syncs, renames and new files, in their order. A
`Disk` takes them up to some moment, and writes the folder as a disk has it that kept what had been synced by then: of a
file the content at the begin of its last sync that ended, of a folder the names at the begin of its own.
"""

from __future__ import annotations

import os
import struct
import subprocess
import tempfile
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import random
    from collections.abc import Iterable

_SOURCE = Path(__file__).with_suffix(".c")
_HEAD = struct.Struct("<qq5I4x")


class Kind(IntEnum):
    """The kinds of events, as numbered in the log."""

    OPEN = 1
    WRITE = 2
    SYNC = 3
    SYNCED = 4
    RENAME = 5
    MAKE = 6
    REMOVE = 7
    CUT = 8
    CLOSE = 9


class Event(NamedTuple):
    """An event: time [ns], kind, process and file, offset in the file, data or paths."""

    time: int
    kind: Kind
    process: int
    file: int
    offset: int
    first: bytes
    second: bytes


@dataclass
class _File:
    """A file: its content, the unsynced writes that may be lost, and the content that the disk keeps."""

    content: bytearray = field(default_factory=bytearray)
    kept: bytes = b""
    unsynced: list[tuple[int, bytes]] = field(default_factory=list)
    syncing: tuple[bytes, int] = (b"", 0)


@dataclass
class _Folder:
    """A folder: its names now, and those that the disk keeps."""

    names: dict[str, _File | _Folder] = field(default_factory=dict)
    kept: dict[str, _File | _Folder] = field(default_factory=dict)
    syncing: dict[str, _File | _Folder] = field(default_factory=dict)


class Recorder:
    """Records what processes do to a folder, which is empty.

    Parameters
    ----------
    folder
        The folder.
    scratch
        Another one, for the compiled library and the log.
    """

    def __init__(self, folder: Path, scratch: Path) -> None:
        self.folder = folder.resolve()
        self._log = scratch / "power_loss.log"
        self._library = scratch / "power_loss.so"
        command = ["cc", "-O2", "-shared", "-fPIC", "-o", str(self._library), str(_SOURCE), "-ldl", "-pthread"]
        subprocess.run(command, check=True)

    @property
    def environment(self) -> dict[str, str]:
        """Of the processes that are to be recorded."""
        preload = " ".join(filter(None, (str(self._library), os.environ.get("LD_PRELOAD"))))
        recorded = {"POWER_LOSS_FOLDER": str(self.folder), "POWER_LOSS_LOG": str(self._log)}
        return {**os.environ, "LD_PRELOAD": preload, **recorded}

    def events(self) -> list[Event]:
        """All events so far."""
        log, position, found = self._log.read_bytes(), 0, []
        while position < len(log):
            time, offset, kind, process, file, first, second = _HEAD.unpack_from(log, position)
            begin = position + _HEAD.size
            position = begin + first + second
            data = log[begin : begin + first], log[begin + first : position]
            found.append(Event(time, Kind(kind), process, file, offset, *data))
        return found


class Disk:
    """A folder on a disk after some events.

    Parameters
    ----------
    folder
        The folder that was recorded.
    events
        What happened to it until the power was lost.
    """

    def __init__(self, folder: Path, events: Iterable[Event] = ()) -> None:
        self._path = folder
        self._root = _Folder()
        self._open: dict[tuple[int, int], _File | _Folder] = {}
        for event in events:
            self.apply(event)

    def apply(self, event: Event) -> None:
        """Take the next event."""
        number = event.process, event.file
        match event.kind:
            case Kind.OPEN:
                self._open[number] = self._opened(event.first, truncated=bool(event.offset))
            case Kind.CLOSE:
                del self._open[number]
            case Kind.WRITE | Kind.SYNC | Kind.SYNCED | Kind.CUT:
                self._change(self._open[number], event)
            case Kind.RENAME:
                folder, name = self._parent(event.first)
                moved = folder.names.pop(name)
                if event.second:
                    target, other = self._parent(event.second)
                    target.names[other] = moved
            case Kind.MAKE:
                folder, name = self._parent(event.first)
                folder.names[name] = _Folder()
            case Kind.REMOVE:
                folder, name = self._parent(event.first)
                del folder.names[name]

    def write(self, target: Path, chance: random.Random | None = None) -> None:
        """Write the folder to `target` with the content that the disk keeps.

        Parameters
        ----------
        target
            A folder that does not exist.
        chance
            Without it everything unsynced is gone. With it, each unsynced write is kept or not by chance (zeros where
            it was, if a later one is kept), and so are the names of each folder.
        """
        _write_folder(self._root, target, chance)

    def _change(self, node: _File | _Folder, event: Event) -> None:
        if isinstance(node, _Folder):
            if event.kind == Kind.SYNC:
                node.syncing = dict(node.names)
            elif event.kind == Kind.SYNCED:
                node.kept = node.syncing
            return
        if event.kind == Kind.WRITE:
            node.content.extend(bytes(max(0, event.offset - len(node.content))))
            node.content[event.offset : event.offset + len(event.first)] = event.first
            node.unsynced.append((event.offset, event.first))
        elif event.kind == Kind.CUT:
            del node.content[event.offset :]
        elif event.kind == Kind.SYNC:
            node.syncing = bytes(node.content), len(node.unsynced)
        else:
            node.kept, count = node.syncing
            del node.unsynced[:count]

    def _parts(self, path: bytes) -> tuple[str, ...]:
        return Path(os.path.normpath(os.fsdecode(path))).relative_to(self._path).parts

    def _parent(self, path: bytes) -> tuple[_Folder, str]:
        """The folder of a path, and its name there."""
        *above, name = self._parts(path)
        folder = self._root
        for part in above:
            below = folder.names[part]
            assert isinstance(below, _Folder), path
            folder = below
        return folder, name

    def _opened(self, path: bytes, truncated: bool) -> _File | _Folder:
        if not self._parts(path):
            return self._root
        folder, name = self._parent(path)
        node = folder.names.setdefault(name, _File())
        if truncated and isinstance(node, _File):
            node.content.clear()
        return node


def _write_folder(folder: _Folder, target: Path, chance: random.Random | None) -> None:
    target.mkdir()
    names = folder.names if chance and chance.random() < 0.5 else folder.kept
    for name, node in names.items():
        if isinstance(node, _Folder):
            _write_folder(node, target / name, chance)
            continue
        content = bytearray(node.kept)
        for offset, data in node.unsynced if chance else ():
            if chance and chance.random() < 0.5:
                content.extend(bytes(max(0, offset - len(content))))
                content[offset : offset + len(data)] = data
        (target / name).write_bytes(content)


def recorded(folder: Path, command: list[str]) -> list[Event]:
    """Run a process until it ends; returns its events in the folder."""
    with tempfile.TemporaryDirectory() as scratch:
        recorder = Recorder(folder, Path(scratch))
        subprocess.run(command, env=recorder.environment, check=True)
        return recorder.events()
