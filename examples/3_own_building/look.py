# SPDX-License-Identifier: Apache-2.0
"""The building's poles and its actuators, as they would be measured."""

import abrace

rig = abrace.characterize("my_rig.yaml")
print(rig.to_pandas())
rig.plot().savefig("picture.png")
