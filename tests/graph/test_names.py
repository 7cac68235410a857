# SPDX-License-Identifier: Apache-2.0
"""Names: two rigs side by side in two namespaces, and topics called otherwise."""

from __future__ import annotations

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock

from abrace.nodes.graph_monitor import GraphMonitor
from abrace_interfaces.msg import Response


def test_two_rigs_in_two_namespaces_do_not_disturb_each_other(new_graph, new_commander):
    with new_graph() as first, new_graph() as second:
        hands, clocks = [], [graph.listen(Clock, "clock") for graph in (first, second)]
        for seed, graph in enumerate((first, second)):
            graph.start("plant", lockstep=True, seed=seed)
            hands.append(new_commander(graph))
            hands[-1].hold(0.0, 260)  # arming and fade
        for force in np.linspace(0, 5000, 100):
            hands[0].answer([force])
            hands[1].answer([-2 * force])
        for hand, end in zip(hands, (5000.0, -10000.0), strict=True):
            hand.hold(end, 2)
            assert hand.commands[-1] == end
            assert [response.sequence for response in hand.responses] == list(range(363))
            shown = [message.clock.nanosec for message in clocks[hands.index(hand)]]
            assert shown[0] == 0, "a clock of its own, from the first sample on"
            assert shown == sorted(shown)
        assert first.node.count_publishers("/clock") == 0, "nobody outside the namespace has its time changed"
        expect_simulated_time(first, hands[0])
        press = first.emergency_stop()
        press(True)
        first.until_fault("plant", f"protective stop: pressed by {first.namespace}/test")
        second.until_well("plant")
        assert hands[0].responses[0].displacement != hands[1].responses[0].displacement, "noise of their own"
        expect_told_apart(faulty=first, well=second)


def expect_simulated_time(graph, hand):
    """A viewer with `use_sim_time` gets the rig's time by a remapping."""
    arguments = ["--ros-args", "-p", "use_sim_time:=true", "-r", f"/clock:={graph.namespace}/clock"]
    viewer = rclpy.create_node("viewer", context=graph.node.context, cli_args=arguments)
    graph.executor.add_node(viewer)
    graph.until(lambda: hand.hold(5000.0, 1) or viewer.get_clock().now().nanoseconds, "the rig's time")
    assert viewer.get_clock().now().nanoseconds <= len(hand.responses) * 2_000_000
    graph.executor.remove_node(viewer)
    viewer.destroy_node()


def expect_told_apart(faulty, well):
    """All report on /diagnostics; a campaign in one namespace takes no fault of a node of the same name in another."""
    heard = faulty.listen(DiagnosticArray, "/diagnostics")
    faults = {}
    with GraphMonitor(well.namespace, ()) as monitor:

        def twice_from_both():
            monitor.spin_once()
            faults.update(monitor.faults)
            names = [status.name for array in heard for status in array.status]
            return monitor.values and all(
                names.count(f"{graph.namespace[1:]}/plant: state") >= 2 for graph in (faulty, well)
            )

        faulty.until(twice_from_both, "two reports of each rig")
        assert monitor.values.keys() == {"plant"}
    assert not faults
    assert {status.hardware_id for array in heard for status in array.status} == {faulty.namespace, well.namespace}


def test_topics_can_be_remapped_and_a_second_node_of_the_same_name_is_told(graph):
    names = ("-r", "response:=measured", "-r", "brace_command:=wanted")
    graph.start("plant", *names, lockstep=True, autostart=False)
    graph.start("excitation", *names, duration=60.0)
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=1, brace_command=1)
    graph.until_matched("excitation", response=1, brace_command=1)
    measured = graph.listen(Response, "measured")
    assert graph.change_state("plant", "activate")
    graph.play("excitation")
    graph.until(lambda: measured and measured[-1].command[0], "a command in force")
    assert graph.node.count_publishers("response") == 0
    assert graph.node.count_publishers("brace_command") == 0
    namesake = rclpy.create_node("plant", namespace=graph.namespace, context=graph.node.context)
    told = f"another node is called {graph.namespace}/plant, expected one: end one of them"
    graph.until(lambda: any(told in line for line in graph.output_of("plant")), "a line on the plant's terminal")
    namesake.destroy_node()
