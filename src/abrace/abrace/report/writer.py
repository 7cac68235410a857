"""The report of a campaign: summary.json, report.md and the tables that the campaign prints.

Made from poles.json, comparison.json and timing.json in the directory of the results (`abrace.report.results`).
"""

from __future__ import annotations

import json
from pathlib import Path

from abrace.report.results import read_results
from abrace.report.summary import summarise
from abrace.report.tables import tables
from abrace_core.files import write_text


def make_report(directory: Path | str) -> str:
    """Write summary.json and report.md into the directory of a campaign's results, and return the tables as text.

    Figures (PNG, SVG) below the directory are shown in report.md.

    Raises
    ------
    AbraceError
        If a file of the results is missing or malformed; nothing is written then.
    """
    directory = Path(directory)
    results = read_results(directory)
    contents = tables(results)
    found = sorted(path.relative_to(directory) for path in directory.rglob("*") if path.suffix in {".png", ".svg"})
    figures = [f"![{path.stem.replace('_', ' ')}]({path.as_posix().replace(' ', '%20')})" for path in found]
    sections = [f"# {directory.resolve().name}", *(table.markdown() for table in contents)]
    write_text(directory / "summary.json", json.dumps(summarise(results), indent=1) + "\n")
    write_text(directory / "report.md", "\n\n".join([*sections, *(["## Figures", *figures] if figures else [])]) + "\n")
    return "\n\n".join(table.text() for table in contents)
