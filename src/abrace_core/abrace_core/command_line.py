# SPDX-License-Identifier: Apache-2.0
"""Command-line parser whose errors are one line and suggest the name that was meant. No ROS."""

from __future__ import annotations

import argparse
import re
from typing import NoReturn

from abrace_core.suggestion import expected_of


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line; its help ends with the `example`."""

    def __init__(self, *, example: str = "", **options: object) -> None:
        options.setdefault("allow_abbrev", False)
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        if example:
            options["epilog"] = f"example: {example}"
        super().__init__(**options)  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        """End with an error in one line, made from the `message` of argparse."""
        self.exit(2, f"{self.prog}: {self._in_words(message)}\n")

    def _in_words(self, message: str) -> str:
        if match := re.match(r"argument (\w+): invalid choice: '(.*?)' \(", message):
            return f"{match[1].lower()} {match[2]!r}: unknown, {expected_of(match[2], self._choices())}"
        if match := re.match(r"the following arguments are required: (.*)", message):
            names = self._choices()
            expected = f"one of {', '.join(names)}" if names else self._form()
            return f"{match[1].removesuffix(', arguments')}: not given, expected {expected}"
        if match := re.match(r"unrecognized arguments: (.*)", message):
            given = match[1].split()[0]
            options = [text for action in self._actions for text in action.option_strings]
            return f"argument {given}: unknown, {expected_of(given, options)}"
        if match := re.match(r"argument (\S+): invalid (\w+) value: '(.*)'", message):
            kind = {"float": "a number", "int": "a whole number"}.get(match[2], "another one")
            return f"argument {match[1]}: {match[3]!r}, expected {kind}"
        if match := re.match(r"argument (\S+): expected (?:one|at least one) argument", message):
            return f"argument {match[1]}: no value after it, expected {self._form()}"
        return f"{message}, expected {self._form()}"

    def _choices(self) -> list[str]:
        return [name for action in self._actions if isinstance(action.choices, dict) for name in action.choices]

    def _form(self) -> str:
        return " ".join(self.format_usage().removeprefix("usage: ").split())
