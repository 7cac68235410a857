# SPDX-License-Identifier: Apache-2.0
"""`abrace benchmark` with a node as controller: each case run in the live graph, on a rig and on a plane frame."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from domain_coordinator import domain_id

SKYHOOK = Path(__file__).parents[2] / "examples/skyhook/skyhook/skyhook.py"
RIG = {"name": "short", "rig": "ncree_three_storey", "duration": 3.0, "weights": ["lqg3"]}
RIG |= {"cases": [{"record": "el_centro", "peak_acceleration": 0.98}]}
FRAME = yaml.safe_load((Path(__file__).parents[2] / "src/abrace/benchmarks/sac_la_20.yaml").read_text())
FRAME |= {"name": "short", "duration": 2.0, "cases": [{"record": "ground.csv", "intensity": 2.0}]}
DAMPERS = """
import sys
import numpy as np
from abrace_core.node.law_node import run_law


class Dampers:
    \"\"\"A damper in each storey.\"\"\"

    def begin(self, floors, groups, sample_period):
        self.period, self.last = sample_period, np.zeros(floors)

    def force(self, sample):
        drift = np.diff(sample.displacement, prepend=0.0)
        rate, self.last = (drift - self.last) / self.period, drift
        return -8.0e5 * rate


def main():
    return run_law(Dampers)


if __name__ == "__main__":
    sys.exit(main())
"""


RUN = """
import json
from pathlib import Path
from abrace.benchmark.live import run_live
from abrace.benchmark_command import open_benchmark

((case, (values, _)),) = run_live(open_benchmark("short.yaml"), "dampers.py", Path()).items()
print(json.dumps({case: values}))
"""


@pytest.fixture
def environment():
    with domain_id() as domain:
        yield os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def run_in(folder: Path, environment: dict[str, str], *command: str) -> str:
    ended = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def check(values: dict[str, float]) -> None:
    assert 0.2 < values["J1"] < 0.95, "the node should have reduced the drift"
    assert values["J11"] > 1e-4, "the devices should have pushed"
    assert not {"J16", "J17"} & set(values), "of a node they are not known"


def test_a_node_is_run_on_a_rig_in_the_live_graph_beside_the_reference_controllers(environment, tmp_path):
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(RIG))
    printed = run_in(tmp_path, environment, "abrace", "benchmark", "short.yaml", "--controller", str(SKYHOOK))
    assert "skyhook" in printed
    found = json.loads((tmp_path / "results/benchmark/short/criteria.json").read_text())
    assert list(found) == ["skyhook", "lqg3"]
    ((case, values),) = found["skyhook"]["cases"].items()
    assert list(found["lqg3"]["cases"]) == [case]
    check(values)
    assert (tmp_path / "results/benchmark/short/profile_1.png").is_file()


def test_a_node_is_run_on_a_frame_in_the_live_graph(environment, tmp_path):
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(FRAME))
    (tmp_path / "dampers.py").write_text(DAMPERS)
    time = np.arange(0, 2.0, 0.02)
    ground = np.sin(2 * np.pi * 1.0 * time) * np.sin(np.pi * time / 2.0) ** 2
    np.savetxt(tmp_path / "ground.csv", np.column_stack([time, ground]), "%.6g", ",", header="t,a [m/s^2]", comments="")
    printed = run_in(tmp_path, environment, sys.executable, "-c", RUN)
    ((case, values),) = json.loads(printed.splitlines()[-1]).items()
    assert case == "ground x 2"
    check(values)
    assert 0.2 < values["J7"] < 0.95
