"""What every node shares, and the one part of a library that imports rclpy.

A node's module holds its parameter table, its callbacks and

    def main() -> int:
        return run(MyNode)
"""

from abrace_core.node.conventions import (
    KEPT_STREAM_QOS,
    LATCHED_QOS,
    LOOK_PERIOD,
    STREAM_QOS,
    AbraceNode,
    RCLError,
    rcl_message,
)
from abrace_core.node.lifecycle import AUTOSTART, AbraceLifecycleNode
from abrace_core.node.parameters import Parameter, declare, find_file
from abrace_core.node.process import run

__all__ = [
    "AUTOSTART",
    "KEPT_STREAM_QOS",
    "LATCHED_QOS",
    "LOOK_PERIOD",
    "STREAM_QOS",
    "AbraceLifecycleNode",
    "AbraceNode",
    "Parameter",
    "RCLError",
    "declare",
    "find_file",
    "rcl_message",
    "run",
]
