# SPDX-License-Identifier: Apache-2.0
"""A ROS domain for the pages that are followed with real nodes, and the demo's results, which pages use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import domain_coordinator
import pytest
from computed_once import computed_once
from page_runner import make_demo

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(scope="module")
def domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A ROS domain that no other test run on this machine uses, for the nodes that a page's commands start."""
    with domain_coordinator.domain_id() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        yield number


@pytest.fixture(scope="session")
def made_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the demo's results; a test works in a copy."""

    def make() -> Path:
        folder = tmp_path_factory.mktemp("demo")
        make_demo(folder)
        return folder

    return computed_once(tmp_path_factory, "demo", make)
