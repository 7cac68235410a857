# SPDX-License-Identifier: Apache-2.0
"""Dependencies of the distribution that `pip install .` makes: those of run.txt, and of the extra `records`."""

from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface


class Dependencies(MetadataHookInterface):
    """Reads the requirements files when the distribution is built."""

    def update(self, metadata: dict) -> None:
        """Add the dependencies to the `metadata` of pyproject.toml."""
        metadata["dependencies"] = self._required("run")
        metadata["optional-dependencies"] = {"records": self._required("records")}

    def _required(self, name: str) -> list[str]:
        lines = Path(self.root, "requirements", f"{name}.txt").read_text(encoding="utf-8").splitlines()
        return [required for line in lines if (required := line.partition("#")[0].strip())]
