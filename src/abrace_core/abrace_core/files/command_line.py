# SPDX-License-Identifier: Apache-2.0
"""Command-line parser whose errors are one line and suggest the name that was meant. No ROS."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any, NoReturn

from abrace_core.files.suggestion import expected_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_core.files.options import Options


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line; its help ends with the `example`."""

    late: Callable[[], type[Options]] | None = None
    """Gives the options that `add_late` adds: their class is imported only if the command is used."""

    def __init__(self, *, example: str = "", **options: object) -> None:
        options.setdefault("allow_abbrev", False)
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        if example:
            options["epilog"] = f"example: {example}"
        super().__init__(**options)  # type: ignore[arg-type]

    def add_late(self) -> None:
        """Add the options of `late`, once."""
        late, self.late = self.late, None
        if late is not None:
            _add_options(self, late())

    def parse_known_args(self, *given: Any, **named: Any) -> Any:
        """As in `ArgumentParser.parse_known_args`, with the options of `late`; what is unknown ends it, here as well.

        A command within a command would leave it to the outer one, which would suggest its own options.
        """
        self.add_late()
        known, unknown = super().parse_known_args(*given, **named)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return known, unknown

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


def _add_options(parser: argparse.ArgumentParser, options: type[Options]) -> None:
    """Add the `options` of a verb to a `parser`: each as --its-name."""
    for name, option in options.listed().items():
        default = "" if option.required or option.default in ("", []) else f"; default {_shown(option.default)}"
        parser.add_argument(
            _flag(name),
            dest=name,
            type=option.kind,
            nargs=option.length or "+" if option.many else None,
            choices=option.choices or None,
            required=option.required,
            metavar=None if option.choices else option.kind.__name__.upper().replace("STR", "TEXT"),
            help=f"{option.text()}{default}".replace("%", "%%"),
        )


def given_options(given: argparse.Namespace, options: type[Options]) -> dict[str, object]:
    """The options of a verb that were `given` on the command line, by name; other arguments are left out."""
    return {name: value for name in options.listed() if (value := getattr(given, name)) is not None}


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _shown(default: object) -> str:
    return " ".join(map(str, default)) if isinstance(default, list) else str(default)
