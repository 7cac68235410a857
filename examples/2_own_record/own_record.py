# SPDX-License-Identifier: Apache-2.0
"""A ground motion from a file: refused as it is, as its offset would carry the table away; then treated."""

import abrace

try:
    abrace.simulate("ncree_three_storey", "quake.csv")
except abrace.AbraceError as error:
    print(error)
run = abrace.simulate("ncree_three_storey", "quake.csv", low_cut=0.3, taper=0.5, peak_acceleration=0.5)
run.plot(["w", "x3", "a3"]).savefig("picture.png")
