# SPDX-License-Identifier: Apache-2.0
"""What every node shares: parameters, life cycle, process, transport. Only this package and `nodes` import rclpy.

A node's module holds its parameter table, its callbacks and

    def main() -> int:
        return run(MyNode)

node            the base class: live parameters, diagnostics
lifecycle       of nodes that move something; threads: the two threads of these
commander       of nodes that answer the rig's samples; law_node: of a user's control law; latency: of the answers
parameters      the table of a node's parameters
process         a node as a process: arguments, signals, exit code; executable: the entry point, before ROS is imported
transport       QoS, DDS profile, the end of a participant
real_time       priority, processors, memory, garbage
stop_listener   the stops of laboratory and rig
"""

from abrace_core import public

__getattr__, __dir__ = public(__name__)
