# SPDX-License-Identifier: Apache-2.0
"""The base classes of all nodes, and `run`; only these modules and the nodes import rclpy.

A node's module holds its parameter table, its callbacks and

    def main() -> int:
        return run(MyNode)
"""

from abrace_core.installed import find_file
from abrace_core.node.conventions import (
    DIAGNOSTICS,
    DISPLAY_PERIOD,
    KEPT_STREAM_QOS,
    STREAM_QOS,
    TRANSIENT_LOCAL_QOS,
    AbraceNode,
    RCLError,
    published_stream_qos,
    rcl_message,
)
from abrace_core.node.lifecycle import AUTOSTART, AbraceLifecycleNode
from abrace_core.node.parameters import Parameter, declare
from abrace_core.node.process import run

__all__ = [
    "AUTOSTART",
    "DIAGNOSTICS",
    "DISPLAY_PERIOD",
    "KEPT_STREAM_QOS",
    "STREAM_QOS",
    "TRANSIENT_LOCAL_QOS",
    "AbraceLifecycleNode",
    "AbraceNode",
    "Parameter",
    "RCLError",
    "declare",
    "find_file",
    "published_stream_qos",
    "rcl_message",
    "run",
]
