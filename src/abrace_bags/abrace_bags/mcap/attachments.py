# SPDX-License-Identifier: Apache-2.0
"""Files of a run as attachments of its bag: rig, model, controller, record."""

from __future__ import annotations

import mimetypes
import time
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import Attachment

from abrace_bags.mcap.records import DamagedError, open_file, parse, read_record
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


@dataclass(frozen=True)
class StoredAttachment:
    """A file of the run, which is read when it is asked for.

    Parameters
    ----------
    path
        Of the MCAP file.
    offset
        Of its record in it.
    name, media_type
        Its own.
    size
        Bytes.
    """

    path: Path
    offset: int
    name: str
    media_type: str
    size: int

    def record(self) -> Attachment:
        """The attachment with its content and times.

        Raises
        ------
        AbraceError
            If it can't be read, or does not match its checksum.
        """
        with open_file(self.path) as (file, size):
            try:
                opcode, body = read_record(file, self.offset, size)
                attachment, rest = parse(Attachment, body)
            except DamagedError as error:
                raise AbraceError(f"{self.path}: attachment {self.name} {error}") from error
        end = len(body) - rest - 4
        if opcode != Opcode.ATTACHMENT or int.from_bytes(body[end : end + 4], "little") not in (
            0,
            zlib.crc32(body[:end]),
        ):
            raise AbraceError(f"{self.path}: attachment {self.name} does not match its checksum")
        return attachment

    @property
    def data(self) -> bytes:
        """Its content; raises as `record`."""
        return self.record().data


def file_attachments(paths: Sequence[Path]) -> list[Attachment]:
    """Files as MCAP attachments, each under its own name; where another file has it, with the folder: `frames/a.yaml`.

    Parameters
    ----------
    paths
        The files.

    Raises
    ------
    AbraceError
        If one can't be read, or two have the same name in folders of the same name.
    """
    attachments: dict[str, Attachment] = {}
    for path in paths:
        name = f"{path.resolve().parent.name}/{path.name}" if path.name in attachments else path.name
        if name in attachments:
            raise AbraceError(f"attachment {path}: another one is called {name}, expected different names")
        try:
            # MCAP has no time before 1970
            content, modified = path.read_bytes(), max(path.stat().st_mtime_ns, 0)
        except OSError as error:
            raise AbraceError(f"attachment {path}: {error.strerror}") from error
        media_type = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        attachments[name] = Attachment(modified, time.time_ns(), name, media_type, content)
    return list(attachments.values())
