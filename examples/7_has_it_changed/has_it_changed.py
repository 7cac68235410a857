# SPDX-License-Identifier: Apache-2.0
"""Modes from vibrations of unknown cause, before and after the first storey has lost a tenth of its stiffness."""

from pathlib import Path

import yaml

import abrace

rig = yaml.safe_load(Path("my_rig.yaml").read_text())
rig["building"]["storey_stiffness"][0] = 1.8e7  # was 2.0e7 N/m
Path("after.yaml").write_text(yaml.safe_dump(rig))
before = abrace.simulate("my_rig.yaml", "white_noise", duration=100.0, seed=1)
after = abrace.simulate("after.yaml", "white_noise", duration=100.0, seed=2)
found = abrace.identify_ambient(after, before=before, band=(0.8, 15.0))
print(found.change.words)
print(found.to_pandas())
found.plot().savefig("picture.png")
