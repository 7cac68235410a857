# SPDX-License-Identifier: Apache-2.0
"""Run a notebook without Jupyter: `python run_notebook.py NOTEBOOK` in a demo's folder puts its outputs into it."""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


def outputs(code: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """What Jupyter shows of a cell that is run with these names: what it prints, and its last expression."""
    tree = ast.parse("\n".join(line for line in code.splitlines() if not line.startswith("%")))
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, "cell", "exec"), names)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None  # type: ignore[attr-defined]
    found: list[dict[str, Any]] = []
    if printed.getvalue():
        found.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)})
    if value is not None:
        data = {"text/plain": [value.to_string() if hasattr(value, "to_string") else str(value)]}
        if isinstance(value, Figure):
            picture = io.BytesIO()
            value.savefig(picture, dpi=60)
            data = {"image/png": [base64.b64encode(picture.getvalue()).decode()]}
        found.append({"output_type": "display_data", "metadata": {}, "data": data})
    return found


def run(notebook: Path, names: dict[str, Any]) -> dict[str, Any]:
    """The notebook with the outputs of its cells, which leave their `names`."""
    content: dict[str, Any] = json.loads(notebook.read_text(encoding="utf-8"))
    for cell in content["cells"]:
        if cell["cell_type"] == "code":
            cell["outputs"] = outputs("".join(cell["source"]), names)
    return content


def page(notebook: Path) -> str:
    """The notebook as a page of the site."""
    parts = []
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        parts += [_shown(each) for each in cell.get("outputs", [])]
    return "\n\n".join([*parts, ""])


def _shown(output: dict[str, Any]) -> str:
    data = output.get("data", {})
    if "image/png" in data:
        return f'<img alt="figure" src="data:image/png;base64,{"".join(data["image/png"])}">'
    return f"```text\n{''.join(output.get('text') or data['text/plain']).rstrip()}\n```"


if __name__ == "__main__":
    path = Path(sys.argv[1])
    ran = run(path, {"__name__": "notebook"})
    path.write_text(json.dumps(ran, indent=1, ensure_ascii=False) + "\n", "utf-8")
    pictures = [
        each["data"]["image/png"][0]
        for cell in ran["cells"]
        for each in cell.get("outputs", [])
        if "image/png" in each.get("data", {})
    ]
    path.with_name("picture.png").write_bytes(base64.b64decode(pictures[-1]))
