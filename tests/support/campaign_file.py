# SPDX-License-Identifier: Apache-2.0
"""Writes a campaign file with given steps, and collects the mistakes reported for one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

TOP = "rig: ncree_three_storey\nlockstep: true"


def day(folder: Path, *steps: str, top: str = TOP) -> Path:
    """Write the campaign file day.yaml; returns its path."""
    path = folder / "day.yaml"
    listed = "\n".join(f"  - {step}" for step in steps)
    path.write_text(f"name: day\n{top}\nsteps:\n{listed}\n")
    return path


def mistakes_of(path: Path, read: Callable[[Path], object]) -> list[str]:
    """The mistakes that `read` reports for a campaign file, line by line, without the name of the file."""
    with pytest.raises(AbraceError) as raised:
        read(path)
    return [line.removeprefix(f"campaign file {path}: ") for line in str(raised.value).splitlines()]
