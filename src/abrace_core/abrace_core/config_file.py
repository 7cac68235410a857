"""YAML files that users write, read and checked key by key, with one-line errors; and numbers written to YAML."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pydantic
import yaml

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

MOST_MISTAKES = 12
"""Mistakes in one file that are told, in one line."""


class Checked(pydantic.BaseModel):
    """Base of every file schema: unknown keys, NaN and infinity are refused, and nothing changes after reading."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Loader(yaml.SafeLoader):
    """YAML in which a duplicate key is an error (by default the last one silently wins), and 1e6 is a number."""

    def compose_mapping_node(self, anchor: dict[Any, yaml.Node]) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        keys = [(key.tag, key.value) for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.composer.ComposerError(None, None, f"key {key[1]!r} stands twice", node.start_mark)
        return node


# YAML 1.1 asks for a point and a sign
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)

Schema = TypeVar("Schema", bound=Checked)


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
    try:
        content = yaml.load(Path(path).read_text(encoding="utf-8"), _Loader)  # a safe loader
    except OSError as error:
        raise AbraceError(f"{kind} file {path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise AbraceError(f"{kind} file {path}: not YAML ({' '.join(str(error).split())})") from error
    if not isinstance(content, dict):
        raise AbraceError(f"{kind} file {path}: expected keys and values, found {type(content).__name__}")
    return content


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
        found = mistakes(error)
        told, left = found[:MOST_MISTAKES], len(found) - MOST_MISTAKES
        raise AbraceError(f"{source}: {'; '.join([*told, *([f'and {left} more'] if left > 0 else [])])}") from error


def mistakes(error: pydantic.ValidationError, tagged: Collection[str] = ()) -> list[str]:
    """Each mistake that an `error` has, as `<key>: <value>, expected ...`, unknown keys first.

    `tagged` are keys of which there are several kinds; the name of the kind that follows in pydantic's is left out.
    """
    # a misspelt key is both unknown and missing: report it as unknown
    found = sorted(error.errors(), key=lambda mistake: mistake["type"] != "extra_forbidden")
    return [_mistake(one, tagged) for one in found]


def _mistake(found: Mapping[str, Any], tagged: Collection[str]) -> str:
    where = found["loc"]
    key = ".".join(str(part) for i, part in enumerate(where) if not (i and where[i - 1] in tagged))
    if not key:
        return f"{found['input']!r}, expected keys and values"
    if found["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    if found["type"] == "missing":
        return f"{key}: key is missing"
    return f"{key}: {found['input']!r}, expected otherwise: {found['msg'].removeprefix('Value error, ')}"


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
