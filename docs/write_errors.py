# SPDX-License-Identifier: Apache-2.0
"""Write docs/errors.md, every message of an error in the source: `python docs/write_errors.py`."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.files import write_text

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/errors.md"
CLASSES = ("AbraceError", "DeviceError", "RefusalError", "RunFailed", "NodeDied", "Refused")
"""Exceptions whose message a person reads."""
FAULT_MODULES = ("safety/*.py", "live/loop.py", "rig/interlocks.py", "devices/udp.py")
"""Modules that give a fault's cause as a text instead of raising it."""
EXPECTED = "ValueError"
"""Raised where a value of a file or an argument is checked: its message stands behind "expected"."""

INTRODUCTION = """# Messages of errors

Written by `python docs/write_errors.py` from the source: every message with which an input is refused or a program
ends, and every fault and error that a node logs. `<path>` is a placeholder for a name or number. To find your message,
search this page for its other words; what to do about the usual ones is in [troubleshooting](troubleshooting.md).

A message is one line: what is wrong, where, and what was expected. All mistakes in a file are reported together,
separated by `;`, in these forms:

- `<kind> file <path>: <key>: <value>, expected <what>`
- `<kind> file <path>: <key>: unknown key, did you mean <key>?`
- `<kind> file <path>: <key>: key is missing`

and mistakes in a node's parameters as `parameter <name>: <value>, expected <what>`. The exit code is 2;
where the message is followed by → 1 it is 1: the input may be right, and something failed while the program ran.
"""


@cache
def sources() -> dict[Path, ast.Module]:
    """The modules of all packages, parsed."""
    paths = sorted((ROOT / "src").glob("abrace*/abrace*/**/*.py"))
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def template(node: ast.expr | None) -> str:
    """A message with `<name>` for what is put into it; empty: it has no text of its own."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(template(part) for part in node.values)
    if isinstance(node, ast.FormattedValue) and isinstance(node.value, ast.Call):
        named = _name(node.value.func)
        if named == "expected_of":
            return "expected one of <names>"
        if named == "did_you_mean":
            return ""
    if isinstance(node, ast.FormattedValue):
        inner = template(node.value) if isinstance(node.value, ast.IfExp | ast.JoinedStr | ast.Constant) else ""
        return inner or f"<{_name(node.value)}>"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return f"{template(node.left) or f'<{_name(node.left)}>'}{template(node.right) or f'<{_name(node.right)}>'}"
    if isinstance(node, ast.IfExp):
        return " / ".join(filter(None, (template(node.body), template(node.orelse))))
    return ""


def _name(node: ast.expr) -> str:
    """A word for what an expression gives."""
    match node:
        case ast.Name():
            return node.id
        case ast.Attribute():
            return node.attr
        case ast.Subscript():
            return _name(node.value)
        case ast.Call(func=ast.Attribute(attr="join"), args=[ast.expr() as inner]):
            return _name(inner)
        case ast.Call(func=ast.Name() | ast.Attribute() as called):
            return _name(node.args[0]) if node.args and called.__class__ is ast.Name else _name(called)
        case ast.BinOp():
            return _name(node.right if isinstance(node.left, ast.Constant) else node.left)
    return "..."


def messages(tree: ast.AST) -> Iterator[str]:
    """The messages of a module's errors; those that have no text of their own are left out."""
    for node in ast.walk(tree):
        text = ""
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
            text = _raised(node.exc.func.id, node.exc.args)
        elif isinstance(node, ast.Call):
            text = _called(node)
        if re.search(r"[a-z]{3}", re.sub(r"<[^>]*>", "", text)):
            yield " ".join(text.split())


def _raised(name: str, given: list[ast.expr]) -> str:
    text = template(given[0]) if given else ""
    if name == EXPECTED:
        return f"expected {text}" if text else ""
    failed = " → 1" if name in ("RunFailed", "NodeDied") else ""
    return f"{text}{failed}" if name in CLASSES and text else ""


def _called(call: ast.Call) -> str:
    """The message of a call that refuses, faults or logs."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    parts = [template(each) or f"<{_name(each)}>" for each in call.args]
    if name == "expect" and len(parts) == 4:
        return f"{parts[1]}: {parts[2]}, expected {parts[3]}"
    if name == "fault" and parts:
        return parts[0]
    if name in ("error", "warning") and parts and "get_logger" in ast.unparse(call.func):
        return parts[0]
    if name == "finish" and len(parts) == 2 and ast.unparse(call.args[0]) == "1":
        return f"{parts[1]} → 1"
    return ""


def faults(tree: ast.AST) -> Iterator[str]:
    """The texts that a module of safety puts together: causes of faults and stops."""
    for node in ast.walk(tree):
        text = template(node) if isinstance(node, ast.JoinedStr) else ""
        if len(re.findall(r"[a-z]{2,}", re.sub(r"<[^>]*>", "", text))) > 1:
            yield " ".join(text.split())


def sections() -> dict[str, dict[str, list[str]]]:
    """The messages by package and module."""
    found: dict[str, dict[str, list[str]]] = {}
    for path, tree in sources().items():
        listed = dict.fromkeys(messages(tree))
        if any(path.match(pattern) for pattern in FAULT_MODULES):
            listed |= dict.fromkeys(faults(tree))
        if listed:
            package, *inside = path.relative_to(ROOT / "src").with_suffix("").parts[1:]
            found.setdefault(package, {})[".".join(inside)] = sorted(listed)
    return found


def exceptions() -> str:
    """The table of the classes: AbraceError and all that derive from it, with what they are for."""
    classes = [
        (".".join(path.relative_to(ROOT / "src").with_suffix("").parts[1:]), node)
        for path, tree in sources().items()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    ]
    bases, more = set[str](), {"AbraceError"}
    while more - bases:
        bases |= more
        more = {node.name for _, node in classes if {ast.unparse(base) for base in node.bases} & bases}
    found = {node.name: (module, _first(node)) for module, node in classes if node.name in bases}
    rows = [f"| `{name}` | `{module}` | {about} |" for name, (module, about) in sorted(found.items())]
    return "\n".join(["## Exceptions\n", "| class | module | what it is |", "|---|---|---|", *rows, ""])


def _first(node: ast.ClassDef) -> str:
    """The first paragraph of a class's docstring, in one line."""
    return " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split())


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION, exceptions()]
    for package, modules in sections().items():
        parts.append(f"## {package}\n")
        for module, listed in modules.items():
            lines = [f"- {'``' if '`' in text else '`'}{text}{'``' if '`' in text else '`'}" for text in listed]
            parts.append("\n".join([f"**{package}.{module}**\n", *lines, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    write_text(PAGE, page())
