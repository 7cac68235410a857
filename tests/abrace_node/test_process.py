# SPDX-License-Identifier: Apache-2.0
"""A node as a process: the exit code, and what is printed."""

import domain_coordinator
import pytest

from abrace_core import AbraceError, RunFailed
from abrace_node.node import AbraceNode
from abrace_node.process import run


@pytest.mark.parametrize(
    ("error", "code"), [(AbraceError("no mass, expected one"), 2), (RunFailed("the cluster died"), 1)]
)
def test_a_wrong_input_has_exit_code_2_and_what_failed_while_it_ran_1(capsys, error, code):
    class Offline(AbraceNode):
        def __init__(self):
            super().__init__("offline", [])

        def work(self):
            raise error

    with domain_coordinator.domain_id() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        assert run(Offline, ["offline"]) == code
    assert capsys.readouterr().err == f"offline: {error}\n"
