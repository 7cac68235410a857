# SPDX-License-Identifier: Apache-2.0
"""Topics and ranges of time: the messages that are asked for, whole, without reading the rest of the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from bag_contents import read_topics
from mcap_chunks import chunk_offsets, without_end
from reference_messages import DEFINITIONS, RESPONSE, STRING, note, response_message, serialised

from abrace_bags import BagWriter

if TYPE_CHECKING:
    from pathlib import Path


def write_bag(directory: Path, samples: int = 400, seed: int = 0) -> Path:
    """Responses every 10 ns, a chunk for each 50 of them; a note in the fifth chunk alone."""
    source = np.random.default_rng(seed)
    with BagWriter(directory, {"run": "selected"}) as bag:
        responses = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], "")
        notes = bag.add_topic("/note", STRING, DEFINITIONS[STRING], "")
        for k in range(samples):
            x = source.normal(size=10) * 10.0 ** source.integers(-300, 300, 10)
            message = response_message(k, x, int(source.integers(-(2**31), 2**31)), k)
            bag.write(responses, serialised(message), 10 * k, 10 * k + 1)
            if k == 210:
                bag.write(notes, note("here"), 2100, 2100)
            if k % 50 == 49:
                bag.flush()
    return directory / f"{directory.name}_0.mcap"


def spoil(path: Path, numbers: set[int]) -> None:
    """Damage the chunks of these numbers: reading them gives a warning."""
    content = bytearray(path.read_bytes())
    for number in numbers:
        content[chunk_offsets(path)[number] + 100] ^= 0xFF
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("begin", "end", "samples"),
    [
        (None, None, range(400)),
        (1000, 2000, range(100, 200)),
        (1001, 2001, range(101, 201)),
        (3990, None, range(399, 400)),
        (None, 1, range(1)),
        (-5, 10, range(1)),
        (2000, 2000, range(0)),
        (9999, 99999, range(0)),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_range_of_time_has_its_begin_and_not_its_end(
    tmp_path: Path, begin: int | None, end: int | None, samples: range, indexed: bool
) -> None:
    path = write_bag(tmp_path / "bag")
    if not indexed:
        content = path.read_bytes()
        path.write_bytes(without_end(content))
    contents = read_topics(path, begin=begin, end=end)
    assert contents["/response"].fields.get("sequence", np.empty(0)).tolist() == list(samples)
    assert contents["/response"].log_time.tolist() == [10 * k for k in samples]
    assert contents["/note"].log_time.size == (210 in samples)
    assert contents.facts == {"run": "selected"}


def test_chunks_outside_the_range_of_time_are_not_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    spoil(path, set(range(8)) - {2, 3})
    contents = read_topics(path, begin=1000, end=2000)
    assert contents.warnings == ()
    assert contents["/response"].fields["sequence"].tolist() == list(range(100, 200))
    assert any("chunk" in warning for warning in read_topics(path, begin=990, end=2000).warnings), "could fail"


def test_chunks_without_the_topic_are_not_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    spoil(path, set(range(8)) - {4})
    contents = read_topics(path, ["/note"])
    assert contents.warnings == ()
    assert contents["/note"].fields["data"].tolist() == ["here"]
    assert contents.facts == {"run": "selected"}
