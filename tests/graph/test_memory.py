# SPDX-License-Identifier: Apache-2.0
"""The memory of nodes that run in lockstep does not grow with the samples: `make soak` in short."""

from __future__ import annotations

import math

from lockstep_endurance import grown_mb, run_in_lockstep

SAMPLES = 11_000
"""Of two runs, at least. What is kept of the last 5000 samples is full after the first one."""
LIMIT = 0.2
"""MB in the second run, after its first thousand samples: 50 bytes a sample; a node that is well grows by 0.03."""


def test_the_memory_of_every_node_is_flat_in_lockstep(graph):
    looks, found = run_in_lockstep(graph, math.inf, SAMPLES)
    second = [look for look in looks if look.run == 2]
    assert second[-1].samples - second[0].samples >= SAMPLES / 2
    grown = grown_mb(second)
    assert set(grown) == {"plant", "ground_motion", "controller"}
    assert max(grown.values()) < LIMIT, grown
    assert not found["lost"]
