# SPDX-License-Identifier: Apache-2.0
"""Numbers in files that may carry their unit: `capacity: 24.5 kN` or, in SI units, `capacity: 24500.0`.

    class Actuator(Checked):
        capacity: Annotated[float, pydantic.Field(gt=0), Quantity("N")]

The value is in the unit of the field, and its bounds apply to that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pydantic

from abrace_core.files.units import number_in

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler


@dataclass(frozen=True)
class Quantity:
    """Annotation of a float in a file's schema: a plain number is in this `unit`, a text is a number with a unit.

    The error for a text in another dimension names the unit that was expected.
    """

    unit: str

    def read(self, value: Any) -> Any:
        """The number in `unit` that a `value` of a file means; what is no number with a unit stays as it is."""
        try:
            return number_in(self.unit, value)
        except ValueError as error:
            raise ValueError(f"{self}: {error}") from error

    def __str__(self) -> str:
        return f"a number in {self.unit}, or one with its unit"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        return pydantic.BeforeValidator(self.read).__get_pydantic_core_schema__(source, handler)

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), "unit": self.unit}
