"""What a bag says of its message types: definition text and type hash, from the installed interface packages."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from abrace_bags.ros2msg import parse_fields, referred_types
from abrace_core.errors import AbraceError

_TYPE_NAME = re.compile(r"([a-z]\w*)/msg/([A-Z]\w*)")
_SEPARATOR = "=" * 80


@dataclass(frozen=True)
class MessageDefinition:
    """What a reader needs to decode a message type.

    Parameters
    ----------
    type_name
        As `std_msgs/msg/Header`.
    text
        The .msg text, then those of the types that it uses, each below a line of 80 `=` and one of `MSG: package/Type`.
    type_hash
        RIHS01 hash of the type.
    """

    type_name: str
    text: str
    type_hash: str


def message_definition(type_name: str) -> MessageDefinition:
    """Definition of an installed message type, found under the folders of AMENT_PREFIX_PATH.

    Parameters
    ----------
    type_name
        As `abrace_interfaces/msg/Response`.

    Raises
    ------
    AbraceError
        If the name is not a message type's, or the type or one that it uses is not installed.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise AbraceError(f"message type {type_name!r}: expected package/msg/Type")
    short_name = f"{match[1]}/{match[2]}"
    own_file = _installed_file(short_name)
    texts: dict[str, str] = {}
    to_read = [short_name]
    while to_read:
        name = to_read.pop(0)
        if name in texts:
            continue
        path = _installed_file(name)
        texts[name] = _read(path)
        try:
            to_read += referred_types(name, parse_fields(texts[name]))
        except AbraceError as error:
            raise AbraceError(f"{path}: {error}") from error
    parts = [texts.pop(short_name)]
    parts += [f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in texts.items()]
    text = "\n".join(part if part.endswith("\n") else f"{part}\n" for part in parts)
    return MessageDefinition(type_name, text, _type_hash(type_name, own_file.with_suffix(".json")))


def _installed_file(short_name: str) -> Path:
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    file_name = f"share/{short_name.replace('/', '/msg/')}.msg"
    for prefix in prefixes:
        path = Path(prefix) / file_name
        if path.is_file():
            return path
    where = f"the {len(prefixes)} folders of AMENT_PREFIX_PATH" if prefixes else "AMENT_PREFIX_PATH, which is empty"
    raise AbraceError(f"message type {short_name} is not installed: no {file_name} in {where}")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise AbraceError(f"{path}: not UTF-8 text") from error


def _type_hash(type_name: str, path: Path) -> str:
    try:
        hashes = {entry["type_name"]: str(entry["hash_string"]) for entry in json.loads(_read(path))["type_hashes"]}
        return hashes[type_name]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise AbraceError(f"{path}: expected `type_hashes` with an entry for {type_name}") from error
