# SPDX-License-Identifier: Apache-2.0
"""The paper's symbols for the rig's signals, used in titles, axes and legends."""

from __future__ import annotations

import re

from abrace_core import signals

RIG = re.compile(r"(w|U\d*|xf?\d*|a\d+|f\d*)$")
"""Names of a rig's signals; others are shown as they are."""


def symbol(name: str) -> str:
    """The symbol of the signal `name` in matplotlib's TeX."""
    if not RIG.match(name):
        return name.replace("_", " ")
    if name == signals.GROUND:
        return "$W$"
    if name[0] == "a":
        return rf"$\ddot{{x}}_{{{name[1:]}a}}$"
    return f"${name[0]}_{{{name[1:]}}}$" if len(name) > 1 else f"${name}$"
