# SPDX-License-Identifier: Apache-2.0
"""What a caller asks of a file, and the words by which a refusal says what can be given there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

SHOWN = 12


def keyword(name: str, value: str) -> str:
    """A keyword of Python: `name` and `value`, if there is one."""
    return f"{name}={value!r}" if value else name


def parameter(name: str, value: str) -> str:
    """A parameter `name` with its `value` of a node, which calls the sample period of a record otherwise."""
    name = "record_sample_period" if name == "sample_period" else name
    return f'-p "{name}:={value}"' if value else name


@dataclass(frozen=True)
class Asked:
    """Unit, sample period [s] and channel as given, None: not given; `way` writes one as the caller would."""

    unit: str | None = None
    sample_period: float | None = None
    channel: str | None = None
    way: Callable[[str, str], str] = keyword

    def one_of(self, channels: list[str], example: str = "") -> str:
        """Which of `channels` can be given, and how: an `example`, or else the first."""
        shown = channels if len(channels) <= SHOWN else [*channels[: SHOWN - 1], f"... {channels[-1]}"]
        example = example or (channels[0].rpartition(" (")[0] or channels[0] if channels else "")
        how = f", such as {self.way('channel', example)}" if example else ""
        return f"channel as one of {', '.join(shown) or 'none'}{how}"

    def period(self) -> str:
        """How a sample period is given."""
        return self.way("sample_period", "")
