"""Which topics a bag is to hold: some by name, those that a pattern finds, or all."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True)
class TopicChoice:
    """Topics by their full names.

    Parameters
    ----------
    names
        Topics that are to come.
    pattern
        Regular expression that is looked for anywhere in a name; empty: none.
    everything
        Whether to take all topics but hidden ones, of which a part begins with an underscore.

    Raises
    ------
    AbraceError
        If the pattern is none, or nothing is chosen.
    """

    names: frozenset[str]
    pattern: str = ""
    everything: bool = False

    def __post_init__(self) -> None:
        try:
            re.compile(self.pattern)
        except re.error as error:
            raise AbraceError(f"pattern {self.pattern!r}: {error}, expected a regular expression") from error
        if not (self.names or self.pattern or self.everything):
            raise AbraceError("no topics: expected names, a pattern, or all")

    def of(self, there: Iterable[str]) -> set[str]:
        """Those of the topics that are `there` which are chosen.

        Parameters
        ----------
        there
            Names of topics.
        """
        return {name for name in there if name in self.names or self._matches(name)}

    def _matches(self, name: str) -> bool:
        if "/_" in name:
            return False
        return self.everything or (self.pattern != "" and re.search(self.pattern, name) is not None)
