# SPDX-License-Identifier: Apache-2.0
"""Sphinx: the pages of this folder, and a reference of what users call, made from docstrings."""

from __future__ import annotations

import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import abrace_plant.devices.card  # noqa: F401 - before autodoc changes the annotations that pydantic reads

sys.path.insert(0, str(Path(__file__).parent))
import run_notebook
import write_measured

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "abrace"
author = "the abrace developers"
copyright = "the abrace developers"  # noqa: A001 - Sphinx's name
version = release = installed_version("abrace_core")
extensions = [
    "myst_parser",  # pages in Markdown
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",  # docstrings as NumPy writes them
    "sphinx_copybutton",
]
exclude_patterns = ["site"]  # what is built
myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "dollarmath", "substitution", "tasklist"]
myst_substitutions = write_measured.numbers()  # {{ name }}
autodoc_mock_imports = ["launch", "launch_ros"]  # only where ROS 2 itself is installed
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
default_role = "code"
napoleon_google_docstring = False
napoleon_attr_annotations = False
man_pages = [("commands", "abrace", "tests of an actively braced building on ROS 2", ["abrace developers"], 1)]
html_theme = "furo"
html_title = f"abrace {release}"
html_static_path = ["static"]
html_css_files = ["wide.css"]
html_search_scorer = str(Path(__file__).parent / "static/scorer.js")
suppress_warnings = ["ref.python"]  # names that several modules have


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


def _notebook(app: Sphinx, name: str, source: list[str]) -> None:  # noqa: ARG001
    """The notebook in the place of its page."""
    if name == "notebook":
        source[0] = run_notebook.page(Path(__file__).parents[1] / "examples/4_notebook/from_bag_to_controller.ipynb")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _notebook)
    app.connect("autodoc-process-docstring", _no_type, priority=100)
    app.connect("autodoc-process-docstring", _as_written)
