# SPDX-License-Identifier: Apache-2.0
"""A controller for the paper's building, and El Centro with it."""

import abrace

law = abrace.design("ncree_three_storey", "lqg3")
run = abrace.simulate("ncree_three_storey", "el_centro", peak_acceleration=0.98, duration=20.0, controller=law)
print(run.to_pandas()[["x3", "a3", "U"]].abs().max())
run.plot(["x3", "a3", "U"]).savefig("picture.png")
