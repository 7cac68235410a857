# SPDX-License-Identifier: Apache-2.0
"""The offsets of the chunks of an MCAP file, as `mcap` reads them from the summary section; a file without its end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcap.reader import make_reader

if TYPE_CHECKING:
    from pathlib import Path

    from mcap.records import ChunkIndex


def chunk_indexes(path: Path) -> list[ChunkIndex]:
    """The chunk indexes of a file, in its order."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return list(summary.chunk_indexes)


def chunk_offsets(path: Path) -> list[int]:
    """The offsets of the chunks of a file."""
    return [index.chunk_start_offset for index in chunk_indexes(path)]


def without_end(content: bytes) -> bytes:
    """The content of a file that `BagWriter` wrote, up to its last chunk: as if it had been killed there."""
    name = b"abrace_topics"
    return content[: content.rindex(name, 0, content.rindex(name)) - 13]
