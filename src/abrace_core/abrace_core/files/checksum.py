# SPDX-License-Identifier: Apache-2.0
"""SHA-256 of files, folders and contents."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path


def file_checksum(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder with their names."""
    if path.is_dir():
        return checksum({str(file.relative_to(path)): file_checksum(file) for file in files_of(path)})
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def checksum(content: object) -> str:
    """SHA-256 of a `content`: arrays, numbers, texts, and dataclasses, mappings and lists of them."""
    found = hashlib.sha256()
    _add(found, content)
    return found.hexdigest()


def _add(found: Any, value: Any) -> None:
    """Add a value to a hash, with its type and shape, so that different values with the same bytes differ."""
    if isinstance(value, np.ndarray):
        found.update(f"array {value.dtype.str} {value.shape}:".encode())
        found.update(np.ascontiguousarray(value).data)
    elif dataclasses.is_dataclass(value):
        _add(found, {each.name: getattr(value, each.name) for each in dataclasses.fields(value)})
    elif isinstance(value, Mapping):
        found.update(f"mapping {len(value)}:".encode())
        for key in sorted(value):
            _add(found, (key, value[key]))
    elif isinstance(value, (tuple, list)):
        found.update(f"list {len(value)}:".encode())
        for each in value:
            _add(found, each)
    else:
        found.update(f"{type(value).__name__} {value!r}:".encode())


def files_of(folder: Path) -> list[Path]:
    """All files below a folder, sorted."""
    return sorted(path for path in folder.rglob("*") if path.is_file())
