"""YAML files that users write, read and checked key by key, with one-line errors; and numbers written to YAML."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pydantic
import yaml

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Mapping, Sequence

    from pydantic_core import ErrorDetails

MOST_MISTAKES = 12
"""Mistakes in one file that are told, in one line."""


class Checked(pydantic.BaseModel):
    """Base of every file schema: unknown keys, NaN and infinity are refused, and nothing changes after reading."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _UniqueKeys(yaml.SafeLoader):
    """YAML in which a duplicate key is an error; by default the last one silently wins."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} stands twice", node.start_mark)
        return super().construct_mapping(node, deep)


Schema = TypeVar("Schema", bound=Checked)


def read_config(path: Path | str, schema: type[Schema], kind: str) -> Schema:
    """Read a YAML file into `schema`.

    Raises
    ------
    AbraceError
        `<kind> file <path>: <key>: <value>, expected ...`, with every mistake found.
    """
    try:
        content = yaml.load(Path(path).read_text(encoding="utf-8"), _UniqueKeys)  # a safe loader
    except OSError as error:
        raise AbraceError(f"{kind} file {path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise AbraceError(f"{kind} file {path}: not YAML ({' '.join(str(error).split())})") from error
    if not isinstance(content, dict):
        raise AbraceError(f"{kind} file {path}: expected keys and values, found {type(content).__name__}")
    return validated(content, schema, f"{kind} file {path}")


def validated(content: Mapping[str, Any], schema: type[Schema], source: str) -> Schema:
    """The `content` checked against `schema`; `source` names it in errors.

    Raises
    ------
    AbraceError
        `<source>: <key>: <value>, expected ...`, with every mistake found: unknown keys first.
    """
    try:
        return schema.model_validate(content)
    except pydantic.ValidationError as error:
        found = sorted(error.errors(), key=lambda mistake: mistake["type"] != "extra_forbidden")
        told = [_sentence(mistake) for mistake in found[:MOST_MISTAKES]]
        more = [f"and {len(found) - MOST_MISTAKES} more"] if len(found) > MOST_MISTAKES else []
        raise AbraceError(f"{source}: {'; '.join([*told, *more])}") from error


def _sentence(mistake: ErrorDetails) -> str:
    key = ".".join(str(part) for part in mistake["loc"])
    if mistake["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    if mistake["type"] == "missing":
        return f"{key}: key is missing"
    return f"{key}: {mistake['input']!r}, expected otherwise: {mistake['msg'].removeprefix('Value error, ')}"


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
    told = [f"{key}: no entry {', '.join(missing)}"] if missing else []
    told += [f"{key}.{name}: unknown" for name in given if name not in names]
    if told:
        raise AbraceError(f"{'; '.join(told)}, expected {', '.join(names)}")


def yaml_number(value: float) -> str:
    """The shortest YAML text that reads back as the same `value`, with a point, so that ROS takes it for a double.

    >>> yaml_number(28122000000.0), yaml_number(1e22), yaml_number(1e-5), yaml_number(0.1 + 0.2)
    ('28122000000.0', '1.0e+22', '1.0e-05', '0.30000000000000004')
    """
    mantissa, e, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent
