# SPDX-License-Identifier: Apache-2.0
"""The completed steps of a campaign: steps.json, with the checksums of each step's inputs and outputs.

A step is complete as long as its inputs (its text, the versions, the rig file, the files and earlier steps that it
names) and its outputs are unchanged. steps.json is rewritten after each step.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import pydantic

from abrace_core import AbraceError
from abrace_core.files.checksum import checksum, file_checksum, files_of
from abrace_core.files.config_file import Checked
from abrace_core.files.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

FILE = "steps.json"
NOT_OF_A_STEP = (FILE, "timing.json", "origin.json")
"""Files that belong to the whole campaign, not to a step."""
Checksums = dict[str, Annotated[str, pydantic.Field(pattern="^[0-9a-f]{64}$")]]


class DoneStep(Checked):
    """A step that is done.

    inputs: checksums by name; outputs: checksums by path in the results; made: checksum of all outputs and the bag;
    bag: folder of a test's bag; timing: the step's entry in timing.json.
    """

    name: str
    inputs: Checksums
    outputs: Checksums
    made: str
    bag: str | None = None
    bag_checksum: str = ""
    timing: dict[str, Any]


class _File(Checked):
    steps: tuple[DoneStep, ...]


class DoneSteps:
    """The steps of a campaign, `names` in order, that are done, with their results in a folder.

    Others in steps.json are ignored.
    """

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self.folder = folder
        self._order = {name: number for number, name in enumerate(names)}
        self._before: dict[Path, tuple[int, ...]] = {}
        self.steps: dict[str, DoneStep] = {}
        try:
            text = (folder / FILE).read_text(encoding="utf-8")
            found = _File.model_validate_json(text).steps
        except FileNotFoundError:
            return  # no step is done
        except (OSError, ValueError) as error:
            raise AbraceError(f"{folder / FILE}: cannot be read, remove {folder} to begin again") from error
        self.steps = {step.name: step for step in found if step.name in self._order}

    def changed(self, name: str, inputs: Mapping[str, str]) -> str:
        """The reason why the step `name`, with these `inputs`, is not complete; empty: it is complete."""
        done = self.steps.get(name)
        if done is None:
            return "it was not done"
        for what in {**inputs, **done.inputs}:
            if inputs.get(what) != done.inputs.get(what):
                return f"{what} has changed"
        for output, expected in done.outputs.items():
            path = self.folder / output
            if not path.is_file() or file_checksum(path) != expected:
                return f"{path} is not as it wrote it"
        if done.bag is not None and (not Path(done.bag).is_dir() or file_checksum(Path(done.bag)) != done.bag_checksum):
            return f"{done.bag} is not as it was recorded"
        return ""

    def keep(self, names: Iterable[str]) -> None:
        """Forget all steps except those with these `names`, and remove all other files from the folder."""
        self.steps = {name: self.steps[name] for name in names if name in self.steps}
        outputs = {self.folder / output for step in self.steps.values() for output in step.outputs}
        for path in files_of(self.folder):
            if path not in outputs:
                path.unlink()
        self._write()

    def forget(self, name: str) -> None:
        """Forget the step `name`, and remove its outputs from the folder."""
        if name in self.steps:
            for output in self.steps.pop(name).outputs:
                (self.folder / output).unlink(missing_ok=True)
            self._write()

    def begin(self) -> None:
        """Note the existing files, before a step."""
        self._before = self._stamps()

    def end(self, name: str, inputs: Mapping[str, str], bag: Path | None, timing: Mapping[str, Any]) -> None:
        """Note that the step `name` is done: its outputs are the files that are new or changed since `begin`.

        `inputs`: checksums by name; `bag`: folder of a test's bag; `timing`: the step's entry in timing.json.
        """
        written = [path for path, stamp in self._stamps().items() if self._before.get(path) != stamp]
        outputs = {path.relative_to(self.folder).as_posix(): file_checksum(path) for path in written}
        recorded = file_checksum(bag) if bag else ""
        for other in [one for one in self.steps.values() if outputs.keys() & one.outputs.keys()]:
            for output in outputs:
                other.outputs.pop(output, None)
            if self._order[other.name] > self._order[name]:
                self.forget(other.name)  # a later step: it is run again and rewrites these files
        self.steps[name] = DoneStep(
            name=name,
            inputs=dict(inputs),
            outputs=outputs,
            made=checksum([outputs, recorded]),
            bag=str(bag) if bag else None,
            bag_checksum=recorded,
            timing=dict(timing),
        )
        self._write()

    def _stamps(self) -> dict[Path, tuple[int, ...]]:
        paths = [path for path in files_of(self.folder) if path.parent != self.folder or path.name not in NOT_OF_A_STEP]
        return {path: (stat.st_ino, stat.st_size, stat.st_mtime_ns) for path in paths for stat in [path.stat()]}

    def _write(self) -> None:
        content = _File(steps=tuple(sorted(self.steps.values(), key=lambda step: self._order[step.name])))
        write_text(self.folder / FILE, content.model_dump_json(indent=1) + "\n")


def copy_results(source: Path, target: Path) -> None:
    """Copy the folder `source` of results to `target`, steps.json last: an interrupted copy has no steps."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, ignore=shutil.ignore_patterns(FILE))
    if (source / FILE).is_file():
        write_text(target / FILE, (source / FILE).read_text(encoding="utf-8"))
