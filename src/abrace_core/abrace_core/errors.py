# SPDX-License-Identifier: Apache-2.0
"""The exceptions whose message is for the user: for mistakes, and for what fails while it runs."""

from __future__ import annotations

import json


class AbraceError(Exception):
    """An input of the user is wrong: the message says what, where, and what was expected.

    A node's `main` prints the message as one line and exits with code 2.
    """


class RunFailed(AbraceError):  # noqa: N818
    """Something failed at run time, though the user's input may be right: the exit code is 1."""


def not_json(error: ValueError) -> str:
    """What is wrong in a file that is no JSON, by the `error` that reading it gave.

    >>> try:
    ...     json.loads("[1, ]")
    ... except ValueError as error:
    ...     print(not_json(error))
    not JSON, line 1, column 5
    """
    if isinstance(error, json.JSONDecodeError):
        return f"not JSON, line {error.lineno}, column {error.colno}"
    return "not JSON, a character that is not UTF-8"
