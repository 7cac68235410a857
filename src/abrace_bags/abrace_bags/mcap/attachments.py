# SPDX-License-Identifier: Apache-2.0
"""Files of a run as attachments of its bag: rig, model, controller, record."""

from __future__ import annotations

import mimetypes
import time
from typing import TYPE_CHECKING

from mcap.records import Attachment

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


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
