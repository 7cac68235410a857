"""The paper's symbols of the rig's signals, for titles, axes and legends."""

from __future__ import annotations

from abrace_core import signals


def symbol(name: str) -> str:
    """The symbol of the signal `name` in matplotlib's TeX."""
    if name == signals.GROUND:
        return "$W$"
    if name[0] == "a":
        return rf"$\ddot{{x}}_{{{name[1:]}a}}$"
    return f"${name[0]}_{{{name[1:]}}}$" if len(name) > 1 else f"${name}$"
