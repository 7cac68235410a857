"""Bags: MCAP files in rosbag2's layout, the record of what happened.

A bag is a directory that `ros2 bag`, `mcap` and `rosbags` read, with the run's facts in it. It is written message by
message (`BagWriter`), and read back whole topics at a time as arrays (`read_topics`) or as a test of the rig
(`read_run`), also when the process that wrote it was killed; `recover` writes such a bag anew, whole.
"""

from abrace_bags.definitions import MessageDefinition, message_definition
from abrace_bags.qos import DEFAULT_QOS, offered_qos
from abrace_bags.reader import BagContents, TopicArrays, read_facts, read_topics
from abrace_bags.recovery import Recovered, recover
from abrace_bags.run import read_run, read_runs
from abrace_bags.writer import BagWriter

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
