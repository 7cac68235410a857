# SPDX-License-Identifier: Apache-2.0
"""Every form of an MCAP file that conforms to the specification is read by every door, without a warning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from mcap_variants import inputs, misread, variant, variants

from abrace_bags import Bag

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", inputs())
def test_every_form_of_a_file_is_read_as_it_was_made(tmp_path: Path, name: str) -> None:
    records = inputs()[name]
    path = tmp_path / "form.mcap"
    some = list(variants(records))[:: 5 if len(records) > 1 else 1]
    assert any("pad" in features for features in some)
    for features in some:
        path.write_bytes(variant(records, features))
        assert misread(path, records, tmp_path / "-".join(features)) == "", features


@pytest.mark.parametrize("features", [("nocrc",), ("nocrc", "ch", "st"), ("nocrc", "ch", "chx", "rch", "rsh", "st")])
def test_a_file_without_checksums_is_read_and_says_so(tmp_path: Path, features: tuple[str, ...]) -> None:
    path = tmp_path / "form.mcap"
    path.write_bytes(variant(inputs()["SeveralMessages"], features))
    bag = Bag(path)
    assert [message.log_time for message in bag.raw()] == [0, 1, 2, 3, 3, 4, 5, 9]
    (warning,) = bag.warnings
    assert "would not be noticed" in warning
