# SPDX-License-Identifier: Apache-2.0
"""The files with the verdict on an identification: validity.json and validity.png."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from abrace_core.drawing import save_figure
from abrace_core.files import write_text
from abrace_sysid.figures.validity import validity_figure

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_sysid.validity.judgement import Judgement


def write_validity(judged: Judgement, output: Path) -> None:
    """Write validity.json and validity.png for the judgement `judged` into the folder `output`."""
    write_text(output / "validity.json", json.dumps(judged.validity.content, indent=1) + "\n")
    save_figure(validity_figure(judged.validity, judged.residuals), output / "validity.png")
