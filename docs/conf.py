# SPDX-License-Identifier: Apache-2.0
"""Sphinx: the pages of this folder, and the reference of the Python packages made from their docstrings."""

from __future__ import annotations

from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "abrace"
author = "the abrace developers"
copyright = "the abrace developers"  # noqa: A001 - Sphinx's name
version = release = installed_version("abrace_core")

extensions = [
    "myst_parser",  # pages in Markdown
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",  # docstrings as NumPy writes them
    "sphinx_copybutton",
]
exclude_patterns = ["site"]  # what is built
templates_path = ["_templates"]
myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "dollarmath", "tasklist"]
autosummary_generate = True
autodoc_mock_imports = ["launch", "launch_ros"]  # only where ROS 2 itself is installed
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
default_role = "code"
napoleon_google_docstring = False
napoleon_attr_annotations = False
html_theme = "furo"
html_title = f"abrace {release}"
suppress_warnings = ["ref.python"]  # names that several modules have
nitpicky = True
nitpick_ignore_regex = [
    ("py:class", r"(?!abrace).*"),  # types of other packages, and short names in signatures: they have no page here
    ("py:class", r"abrace[\w.]*\._\w+"),  # private ones
    ("py:class", r"abrace_interfaces\..*"),  # generated from the messages (topics.md)
    ("py:class", r"abrace_bags\.mcap\.records\.Record"),  # a type variable
]


COLON = "\ue000"
"""In place of a colon until napoleon has read a docstring."""
ATTRIBUTES = ("attribute", "data", "property")


def _no_type(app: Sphinx, what: str, name: str, given: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    """The first line of an attribute's docstring is a sentence: napoleon takes what is before a colon for a type."""
    if what in ATTRIBUTES and lines:
        lines[0] = lines[0].replace(":", COLON)


def _as_written(app: Sphinx, what: str, name: str, given: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    """Bars and stars of a docstring are those of formulas, not reStructuredText's."""
    lines[:] = [line.replace("|", r"\|").replace("**", r"\*\*").replace(COLON, ":") for line in lines]


def _remove_old_pages(app: Sphinx) -> None:
    """Remove the generated pages of modules that have been moved or removed."""
    for page in (Path(app.srcdir) / "packages").glob("*.rst"):
        module = Path(app.srcdir).parent / "src" / page.stem.partition(".")[0] / page.stem.replace(".", "/")
        if not module.is_dir() and not module.with_suffix(".py").exists():
            page.unlink()


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", _remove_old_pages, priority=100)
    app.connect("autodoc-process-docstring", _no_type, priority=100)
    app.connect("autodoc-process-docstring", _as_written)
