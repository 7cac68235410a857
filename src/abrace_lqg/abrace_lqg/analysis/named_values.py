# SPDX-License-Identifier: Apache-2.0
"""Tuples that are objects in JSON files: each value under its name."""

from __future__ import annotations

from typing import Annotated, Any

import pydantic


class Named:
    """Annotates a tuple whose values are under these `names` in files, whatever their order there.

    >>> from typing import Annotated
    >>> from pydantic import TypeAdapter
    >>> span = TypeAdapter(Annotated[tuple[float, float], Named("lowest_hz", "highest_hz")])
    >>> span.dump_python((0.3, 10.0)), span.validate_python({"highest_hz": 10.0, "lowest_hz": 0.3})
    ({'lowest_hz': 0.3, 'highest_hz': 10.0}, (0.3, 10.0))
    """

    def __init__(self, *names: str) -> None:
        self.names = names

    def __get_pydantic_core_schema__(self, source: Any, handler: pydantic.GetCoreSchemaHandler) -> Any:
        """How pydantic reads and writes it."""
        both = pydantic.BeforeValidator(self._values), pydantic.PlainSerializer(self._object)
        return handler.generate_schema(Annotated[source, *both])

    def _object(self, values: tuple[Any, ...]) -> dict[str, Any]:
        return dict(zip(self.names, values, strict=True))

    def _values(self, given: Any) -> tuple[Any, ...]:
        if not isinstance(given, dict) or given.keys() != set(self.names):
            raise ValueError(f"an object with {', '.join(self.names)}")
        return tuple(given[name] for name in self.names)
