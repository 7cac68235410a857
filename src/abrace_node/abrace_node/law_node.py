# SPDX-License-Identifier: Apache-2.0
"""The node of a user's control law, with the limits, stops and latched faults of every node that commands braces."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.own_law import GuardedLaw, law_options, make_law
from abrace_node.commander import BraceCommander
from abrace_node.parameters import Parameter
from abrace_node.process import run

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_core.model.own_law import Law

PARAMETERS = (
    Parameter("sample_rate", 500.0, "Hz, sample rate of the rig", minimum=1.0),
    Parameter("force_limit", [24500.0], "N, greatest force of one brace of each group", minimum=1.0),
    Parameter("ramp_time", 0.5, "s, duration of the force's fade-in", minimum=0.0),
)


class LawNode(BraceCommander):
    """Answers each sample with the law's force."""

    law: ClassVar[Callable[..., Law]]

    def __init__(self) -> None:
        options = law_options(self.law)
        self.options = tuple(options)
        own = [Parameter(key, value, f"of {self.law.__name__}") for key, value in options.items()]
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", self.law.__name__).lower()
        super().__init__(name, [*own, *PARAMETERS])

    def configure(self) -> None:
        """Create the law, with the node's parameters."""
        given = self.parameters
        law = make_law(type(self).law, {name: getattr(given, name) for name in self.options})
        self.guarded = GuardedLaw(law, 1 / given.sample_rate, given.ramp_time)
        self.nothing = np.zeros(len(given.force_limit))
        self.create_topics(1 / given.sample_rate, given.force_limit)

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Restart the law from rest."""
        if groups != len(self.nothing):
            self.safety.fault(
                f"the rig has {groups} brace groups, expected {len(self.nothing)} (parameter force_limit)"
            )
            return
        try:
            self.guarded.begin(floors, groups)
        except AbraceError as error:
            self.safety.fault(str(error))

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> np.ndarray:
        """The law's force; an error in the law is a fault, after which the command is zero."""
        try:
            return np.array(self.guarded.force(sequence, z, self.responses.command, lost))
        except AbraceError as error:
            self.safety.fault(str(error))
            return self.nothing


def run_law(law: type[Law]) -> int:
    """Run the node of a `law` until it ends; returns the process's exit code. Its name is the class's in lower case."""
    return run(type(law.__name__, (LawNode,), {"law": law, "__module__": law.__module__}))
