# SPDX-License-Identifier: Apache-2.0
"""Bags: MCAP files in rosbag2's layout, the record of a test.

A bag is a directory that `ros2 bag`, `mcap` and `rosbags` read, with the run's facts in it. It is written message by
message (`BagWriter`), and read back whole topics at a time as arrays (`read_topics`) or as a test of the rig
(`read_run`), also when the process that wrote it was killed; `recover` makes a complete bag of such a one.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from abrace_bags.definitions import MessageDefinition, message_definition
    from abrace_bags.qos import DEFAULT_QOS, offered_qos
    from abrace_bags.reader import BagContents, TopicArrays, read_facts, read_topics
    from abrace_bags.recovery import Recovered, recover
    from abrace_bags.run import read_run, read_runs
    from abrace_bags.writer import BagWriter

_MODULES = {
    "bag": ("read_facts",),
    "definitions": ("MessageDefinition", "message_definition"),
    "qos": ("DEFAULT_QOS", "offered_qos"),
    "reader": ("BagContents", "TopicArrays", "read_topics"),
    "recovery": ("Recovered", "recover"),
    "run": ("read_run", "read_runs"),
    "writer": ("BagWriter",),
}
"""Where names are defined: a module is imported when one is used, as reading needs no writer."""

__all__ = [
    "DEFAULT_QOS",
    "BagContents",
    "BagWriter",
    "MessageDefinition",
    "Recovered",
    "TopicArrays",
    "message_definition",
    "offered_qos",
    "read_facts",
    "read_run",
    "read_runs",
    "read_topics",
    "recover",
]


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"abrace_bags.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
