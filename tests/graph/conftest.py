# SPDX-License-Identifier: Apache-2.0
"""The real nodes as processes of their own over real DDS, on a ROS domain of their own, beside a node of the tests.

Every test has a namespace of its own.
"""

from __future__ import annotations

import contextlib
import itertools
from typing import TYPE_CHECKING

import domain_coordinator
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions
from running_graph import Commander, Graph

from abrace.processes.group import ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@pytest.fixture(scope="session")
def domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A ROS domain that no other test run on this machine uses, for this process and the nodes."""
    with domain_coordinator.domain_id() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("OMP_NUM_THREADS", "1")
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        yield number


@pytest.fixture(scope="session")
def context(domain: int) -> Iterator[rclpy.Context]:
    """The tests' own participant."""
    context = rclpy.Context()
    context.init(domain_id=domain)
    rclpy.signals.install_signal_handlers(SignalHandlerOptions.NO)
    yield context
    context.try_shutdown()


@pytest.fixture(scope="session")
def new_graph(
    context: rclpy.Context, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[], contextlib.AbstractContextManager[Graph]]:
    """Makes graphs, each a context manager that leaves no node behind."""
    number = itertools.count(1)

    @contextlib.contextmanager
    def new() -> Iterator[Graph]:
        namespace = f"/test_{next(number)}"
        with ProcessGroup() as processes:
            graph = Graph(namespace, tmp_path_factory.mktemp(namespace[1:]), context, processes)
            try:
                yield graph
            finally:
                graph.close()

    return new


@pytest.fixture
def graph(new_graph: Callable[[], contextlib.AbstractContextManager[Graph]]) -> Iterator[Graph]:
    """A new graph for the test."""
    with new_graph() as fresh:
        yield fresh


@pytest.fixture(scope="session")
def new_commander() -> type[Commander]:
    """Makes a `Commander` of a rig's braces."""
    return Commander
