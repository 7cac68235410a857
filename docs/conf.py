# SPDX-License-Identifier: Apache-2.0
"""Sphinx: the pages of this folder, and the reference of the Python packages made from their docstrings."""

from __future__ import annotations

from importlib.metadata import version as installed_version
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
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
default_role = "code"
napoleon_google_docstring = False
napoleon_attr_annotations = False
html_theme = "furo"
html_title = f"abrace {release}"
suppress_warnings = ["ref.python"]  # names that several modules have


def _as_written(app: Sphinx, what: str, name: str, given: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    """Bars and stars of a docstring are those of formulas, not reStructuredText's."""
    lines[:] = [line.replace("|", r"\|").replace("**", r"\*\*") for line in lines]


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _as_written)
