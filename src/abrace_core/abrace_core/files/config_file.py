# SPDX-License-Identifier: Apache-2.0
"""YAML files that users write, read and checked key by key, with one-line errors; and numbers written to YAML."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_mistakes import mistakes
from abrace_core.files.reading import read_yaml

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(pydantic.BaseModel)

MOST_MISTAKES = 12
"""Greatest number of mistakes in one file that are listed in its error."""


class _OneLineErrors(ModelMetaclass):
    """Of classes that, called with wrong keywords, raise AbraceError: as a file with these keys does."""

    who: str

    def __call__(self, *arguments: Any, **given: Any) -> Any:
        try:
            return super().__call__(*arguments, **given)
        except pydantic.ValidationError as error:
            raise AbraceError(f"{self.who}: {'; '.join(mistakes(error, self))}") from error


class Checked(pydantic.BaseModel, metaclass=_OneLineErrors):
    """Base of every file schema: unknown keys, NaN and infinity are refused, and nothing changes after reading.

    `who` is what errors begin with where the class is called with keywords.
    """

    who: ClassVar[str] = "file"

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Schema = TypeVar("Schema")
"""A class of pydantic's, or a dataclass."""
Number = Annotated[
    float,
    pydantic.WrapValidator(lambda given, read: math.nan if given is None else read(given)),
    pydantic.PlainSerializer(lambda value: "inf" if value == math.inf else value),
]
"""In JSON files null where it is NaN, which nothing passes with, and the text inf where it is infinite."""


def read_config(path: Path | str, schema: type[Schema], kind: str) -> Schema:
    """Read a YAML file into `schema`.

    Raises
    ------
    AbraceError
        `<kind> file <path>: <key>: <value>, expected ...`, with every mistake found.
    """
    return validated(read_mapping(path, kind), schema, f"{kind} file {path}")


def read_mapping(path: Path | str, kind: str) -> dict[str, Any]:
    """The keys and values of a YAML file, unchecked.

    Raises
    ------
    AbraceError
        If it cannot be read or is something else; the file is called a `kind`.
    """
    content = read_yaml(path, kind)
    if not isinstance(content, dict):
        raise AbraceError(f"{kind} file {path}: {_found(content)}, expected keys and values")
    return content


def validated(content: Mapping[str, Any], schema: type[Schema], source: str) -> Schema:
    """The `content` checked against `schema`; `source` names it in errors.

    Raises
    ------
    AbraceError
        `<source>: <key>: <value>, expected ...`, with every mistake found: unknown keys first.
    """
    try:
        return pydantic.TypeAdapter(schema).validate_python(content)
    except pydantic.ValidationError as error:
        found = mistakes(error, schema)
        more = [f"and {len(found) - MOST_MISTAKES} more"] if len(found) > MOST_MISTAKES else []
        raise AbraceError(f"{source}: {'; '.join([*found[:MOST_MISTAKES], *more])}") from error


def _found(content: object) -> str:
    if content is None:
        return "empty"
    return "a list" if isinstance(content, list) else f"{content!r:.60}"


def expect_entries(given: Iterable[str], names: Sequence[str], key: str) -> None:
    """Refuse entries of a file that are not one for each of some names.

    Parameters
    ----------
    given, names
        The names of the entries that there are, and that there must be.
    key
        Of the entries in their file, for errors.

    Raises
    ------
    AbraceError
        With all names that are missing, and all that are unknown.
    """
    given = list(given)
    missing = [name for name in names if name not in given]
    problems = [f"{key}: no entry {', '.join(missing)}"] if missing else []
    problems += [f"{key}.{name}: unknown" for name in given if name not in names]
    if problems:
        raise AbraceError(f"{'; '.join(problems)}, expected {', '.join(names)}")


def yaml_number(value: float) -> str:
    """The shortest YAML text that reads back as the same `value`, with a point, so that ROS takes it for a double.

    >>> yaml_number(28122000000.0), yaml_number(1e22), yaml_number(1e-5), yaml_number(0.1 + 0.2)
    ('28122000000.0', '1.0e+22', '1.0e-05', '0.30000000000000004')
    """
    mantissa, e, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent
