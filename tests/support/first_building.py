"""docs/first_building.md, followed: its files are written into a folder, its commands given there; no more is known."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs/first_building.md").read_text()
FILES = dict(re.findall(r"```(?:yaml|python)\n# (\S+)\n(.*?)```", PAGE, re.DOTALL))
COMMANDS = re.findall(r"^    ((?:abrace|python) .*)$", PAGE, re.MULTILINE)
WHOLE_DAY = "abrace campaign my_day.yaml"
"""The command that takes a minute."""


def follow(folder: Path, without: str = "") -> dict[str, str]:
    """What each command of the page prints in a new `folder`, but for the one `without`.

    Raises
    ------
    RuntimeError
        If a command does not end with 0.
    """
    for name, content in FILES.items():
        (folder / name).write_text(content)
    printed = {}
    for command in COMMANDS:
        if command != without:
            ended = subprocess.run(command.split(), cwd=folder, capture_output=True, text=True, check=False)
            if ended.returncode:
                raise RuntimeError(f"{command}\n{ended.stdout}{ended.stderr}")
            printed[command] = ended.stdout
    return printed
