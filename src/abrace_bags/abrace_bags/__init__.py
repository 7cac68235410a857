# SPDX-License-Identifier: Apache-2.0
"""Bags: MCAP files in rosbag2's layout, the record of a test.

A bag is a directory that `ros2 bag`, `mcap` and `rosbags` read, with the run's facts in it. It is written message by
message (`BagWriter`), and read (`Bag`) as serialised messages, as arrays, or as tests of the rig (`read_run`), also
when the process that wrote it was killed; `recover` makes a complete bag of such a one, `trim` and `merge` make one of
a part, and of several.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core import public

if TYPE_CHECKING:
    from abrace_bags.bag import Bag, read_run, read_runs
    from abrace_bags.copies import CopiedBag, merge, recover, trim
    from abrace_bags.definitions import MessageDefinition, message_definition
    from abrace_bags.description import BagDescription, describe
    from abrace_bags.export import write_csv, write_mat
    from abrace_bags.mcap.attachments import file_attachments
    from abrace_bags.qos import DEFAULT_QOS, offered_qos
    from abrace_bags.raw import RawMessage, RawMessages
    from abrace_bags.reader import TopicArrays, TopicParts
    from abrace_bags.topics import RecordedTopic
    from abrace_bags.writer import BagWriter

__all__ = [
    "DEFAULT_QOS",
    "Bag",
    "BagDescription",
    "BagWriter",
    "CopiedBag",
    "MessageDefinition",
    "RawMessage",
    "RawMessages",
    "RecordedTopic",
    "TopicArrays",
    "TopicParts",
    "describe",
    "file_attachments",
    "merge",
    "message_definition",
    "offered_qos",
    "read_run",
    "read_runs",
    "recover",
    "trim",
    "write_csv",
    "write_mat",
]

__getattr__, __dir__ = public(
    __name__,
    {
        "abrace_bags.bag": "Bag read_run read_runs",
        "abrace_bags.copies": "CopiedBag merge recover trim",
        "abrace_bags.definitions": "MessageDefinition message_definition",
        "abrace_bags.description": "BagDescription describe",
        "abrace_bags.export": "write_csv write_mat",
        "abrace_bags.mcap.attachments": "file_attachments",
        "abrace_bags.qos": "DEFAULT_QOS offered_qos",
        "abrace_bags.raw": "RawMessage RawMessages",
        "abrace_bags.reader": "TopicArrays TopicParts",
        "abrace_bags.topics": "RecordedTopic",
        "abrace_bags.writer": "BagWriter",
    },
)
"""A module is imported when a name of it is used, as reading needs no writer."""
