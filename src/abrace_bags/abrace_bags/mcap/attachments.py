"""Files of a run that stand in its bag whole: rig, model, controller, record."""

from __future__ import annotations

import mimetypes
import time
import zlib
from typing import TYPE_CHECKING

from mcap.records import Attachment

from abrace_bags.mcap.records import DamagedError, RecordFields
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def file_attachments(paths: Sequence[Path]) -> list[Attachment]:
    """Files as MCAP attachments, each under its own name.

    Parameters
    ----------
    paths
        The files.

    Raises
    ------
    AbraceError
        If one can't be read, or two have the same name.
    """
    attachments: dict[str, Attachment] = {}
    for path in paths:
        if path.name in attachments:
            raise AbraceError(f"attachment {path}: another one is called {path.name}, expected different names")
        try:
            # MCAP knows no time before 1970
            content, changed = path.read_bytes(), max(path.stat().st_mtime_ns, 0)
        except OSError as error:
            raise AbraceError(f"attachment {path}: {error.strerror}") from error
        media_type = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        attachments[path.name] = Attachment(changed, time.time_ns(), path.name, media_type, content)
    return list(attachments.values())


def parse_attachment(body: bytes) -> Attachment:
    """An attachment from the `body` of its record.

    Raises
    ------
    DamagedError
        If it does not fit its checksum, or its lengths do not fit.
    """
    fields = RecordFields(body)
    times = fields.number(8), fields.number(8)
    name, media_type = fields.text(), fields.text()
    data = fields.take(fields.number(8))
    checksum = fields.number(4)
    fields.end()
    if checksum not in (0, zlib.crc32(body[:-4])):
        raise DamagedError("is an attachment that does not fit its checksum")
    log_time, create_time = times
    return Attachment(create_time, log_time, name, media_type, data)
