# SPDX-License-Identifier: Apache-2.0
"""Names that a misspelt one may have meant. Launch files use it too: the standard library alone."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection


def did_you_mean(given: str, names: Collection[str]) -> str:
    """A question to append to an error message: the nearest of `names` to the one `given`; empty if none is near.

    >>> did_you_mean("ncree_three_story", ["five_storey", "ncree_three_storey"])
    ', did you mean ncree_three_storey?'
    >>> did_you_mean("x", ["five_storey"])
    ''
    """
    by_lower = {name.lower(): name for name in sorted(names)}
    near = difflib.get_close_matches(given.lower(), by_lower, 1, 0.6)
    return f", did you mean {by_lower[near[0]]}?" if near and by_lower[near[0]] != given else ""


def expected_of(given: str, names: Collection[str]) -> str:
    """The end of an error message about the name `given`: the nearest of the `names`, or else all of them.

    >>> expected_of("lgq3", ["lqg1", "lqg3", "half"])
    'expected one of half, lqg1, lqg3, did you mean lqg3?'
    """
    return f"expected one of {', '.join(sorted(names)) or 'none'}{did_you_mean(given, names)}"
