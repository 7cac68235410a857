# SPDX-License-Identifier: Apache-2.0
"""El Centro without and with the law, in Python alone."""

from sliding_mode.sliding_mode import SlidingMode

import abrace

motion = {"record": "el_centro", "peak_acceleration": 0.980665, "duration": 20.0}
free = abrace.simulate("ncree_three_storey", **motion).to_pandas()
run = abrace.simulate("ncree_three_storey", **motion, controller=SlidingMode())
print((run.to_pandas().std() / free.std())[["x1", "x2", "x3", "a1", "a2", "a3"]])
run.plot(["x3", "a3", "U"]).savefig("picture.png")
