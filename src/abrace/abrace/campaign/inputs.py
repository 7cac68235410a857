# SPDX-License-Identifier: Apache-2.0
"""The inputs of a campaign's steps as checksums: its text, the versions, files, and the outputs of earlier steps."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.campaign.tasks import RigTest
from abrace_bags.metadata import METADATA_FILE, installed_versions
from abrace_core.files.checksum import checksum, file_checksum
from abrace_plant.devices.file import calibration_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from abrace.campaign.file import Campaign
    from abrace.campaign.laboratory import Laboratories


class Inputs:
    """The inputs of the steps of a campaign."""

    def __init__(self, campaign: Campaign, laboratories: Laboratories) -> None:
        self._campaign, self._laboratories = campaign, laboratories
        versions = installed_versions() | {"scipy": version("scipy")}
        setup = asdict(campaign.setup) | {"node": campaign.setup.node and campaign.setup.node.model_dump(mode="json")}
        self._common = {
            "the head of the campaign file": checksum([setup, campaign.lockstep, campaign.thread_priority]),
            "a version": checksum(versions),
            **_files(_words(setup)),
        }

    def of(self, number: int, made: Mapping[str, str]) -> dict[str, str]:
        """Checksums of the inputs of a step by its `number`, 0 the first.

        `made`: checksums of all outputs of earlier steps, by name.

        Each value in its text that names an earlier step, a file or a bag is an input. The seed of a test's sensor
        noise depends on the number.
        """
        task = self._campaign.steps[number].task
        text = task.model_dump(mode="json")
        found = self._common | {"its text": checksum([type(task).__name__, text])}
        if isinstance(task, RigTest):
            found["its place among the steps"] = checksum(number)
            lab = self._laboratories.of(task)
        else:
            lab = self._laboratories.behind(task)[0]
        devices = (lab.device_file, calibration_of(lab.device_file)) if lab.device_file is not None else ()
        found |= _files(str(path) for path in (lab.rig_file, *devices) if path is not None)
        words = sorted(set(_words(text)))
        earlier = {step.name for step in self._campaign.steps[:number]}
        found |= {f"step {word}": made.get(word, "") for word in words if word in earlier}
        return found | _files(word for word in words if word not in earlier)


def _files(words: Iterable[str]) -> dict[str, str]:
    """Checksums of the files, bags and folders of models among some words."""
    paths = [Path(word) for word in words if word]
    models = [path for folder in paths if (folder / "model.json").is_file() for path in sorted(folder.glob("*.json"))]
    found = [path for path in paths if path.is_file() or (path / METADATA_FILE).is_file()]
    return {f"file {path}": file_checksum(path) for path in (*found, *models)}


def _words(content: object) -> Iterator[str]:
    """Every string in `content`, which is of JSON's types."""
    if isinstance(content, str):
        yield content
    elif isinstance(content, dict):
        for value in content.values():
            yield from _words(value)
    elif isinstance(content, list):
        for value in content:
            yield from _words(value)
