# SPDX-License-Identifier: Apache-2.0
"""Every file that a page shows passes its schema; Python is run by `test_pages.py`."""

import re

import pytest
import write_nodes
from documents import PAGES, blocks

from abrace.campaign.file import load_campaign
from abrace_core import AbraceError
from abrace_core.files.config_file import read_config
from abrace_core.files.reading import parse_yaml
from abrace_lqg.weights import Weights
from abrace_plant.devices.calibration import CalibrationFile
from abrace_plant.devices.udp import UdpFile
from abrace_plant.rig.file import _Interlocks, load_rig
from abrace_studies.benchmark.definition import load_definition

OWN_KIND = ("ni_daqmx", "my_daq")
"""Devices of the reader's."""


def yaml_of(page) -> list[str]:
    """The YAML blocks of a page, those that are indented and look like a file of ours too."""
    own = re.compile(r"(?:kind|name|channels|interlocks|building): ?[^=]*\n")
    return [
        block.text
        for block in blocks(page)
        if block.language == "yaml" or (not block.language and own.match(block.text) and "Traceback" not in block.text)
    ]


def mistake(text: str, folder) -> str:
    """What is wrong in a file; empty: nothing."""
    content = parse_yaml(text, "block")
    file = folder / "block.yaml"
    file.write_text(text)
    try:
        match content:
            case {"steps": _}:
                load_campaign(file)
            case {"cases": _}:
                load_definition(str(file))
            case {"building": _, "braces": _}:
                load_rig(file)
            case {"kind": "udp"}:
                read_config(file, UdpFile, "device")
            case {"kind": kind} if kind in OWN_KIND:
                return ""
            case {"channels": _, "commands": _}:
                read_config(file, CalibrationFile, "calibration")
            case {"measured": _, "weights": _}:
                read_config(file, Weights, "weights")
            case {"interlocks": {}}:
                _Interlocks.model_validate(content["interlocks"])
            case dict() if all("ros__parameters" in inside for inside in content.values()):
                return parameter_mistake(content)
            case _:
                return f"a file of no kind that abrace has: {text[:80]}"
    except AbraceError as error:
        return str(error)
    return ""


def parameter_mistake(content) -> str:
    """Parameters that a node does not have."""
    for name, inside in content.items():
        node = name.rpartition("/")[2]
        package = next(package for package, nodes in write_nodes.NODES.items() if node in nodes)
        known = {parameter.name for parameter in write_nodes.parameters(package, node)}
        if unknown := set(inside["ros__parameters"]) - known:
            return f"{node}: {unknown}"
    return ""


@pytest.mark.parametrize("page", [page for page in PAGES if yaml_of(page)], ids=lambda page: page.name)
def test_files_pass_their_schemas(page, tmp_path):
    wrong = [found for text in yaml_of(page) if (found := mistake(text, tmp_path))]
    assert not wrong, "\n".join(wrong)
