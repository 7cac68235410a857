# SPDX-License-Identifier: Apache-2.0
"""The paper's numbers of its rig, with which the simulated rig is compared."""

from __future__ import annotations

from abrace_core.model.response import PAPER_RIG

RIG = PAPER_RIG
"""Name of the rig file that describes it."""

BARE = ((6.673, 0.0081), (21.783, 0.0025), (37.506, 0.0034))
"""The frame without braces: (frequency [rad/s], damping ratio) of each mode ("Experimental setup")."""

ZERO_COMMAND = ((7.363, 0.0138), (22.933, 0.0246), (37.966, 0.0132))
"""The frame with braces under zero command, likewise."""

PAPER_POLES = {
    "table": (-0.110 + 7.275j, -0.545 + 22.846j, -0.468 + 37.939j),
    "command": (
        -0.111 + 7.254j,
        -0.481 + 23.316j,
        -0.448 + 37.896j,
        -0.696 + 56.549j,
        -0.532 + 105.277j,
        -8.263 + 134.815j,
    ),
}
"""Eigenvalues of A1, from the table test, and of A2, from the command test [rad/s] (Eqs. 3 and 4)."""

EXTRA = tuple((abs(pole), -pole.real / abs(pole)) for pole in PAPER_POLES["command"][3:])
"""The three further pairs among the eigenvalues of A2, which the command excites, likewise (Eq. 4)."""

BENCH_LAG = 0.0008
"""Constant delay of the actuator on the bench [s] (Fig. 2)."""

BENCH_BAND = 30.0
"""Hz up to which the command's white noise reaches (Fig. 3)."""

SHAPE = (0.159 / 0.371, 0.292 / 0.371, 1.0)
"""Displacements of the floors over that of the top: rms of Table 1's experiment, where the first mode rules."""

STROKE_RATIO = 0.127 / 0.159
"""Stroke over displacement of the first floor: rms of Table 1's experiment."""

INTENSITY = {"w": 0.02 * 9.80665, "U": 186.0 * 9.80665}
"""Rms of the ground acceleration [m/s^2] and of the command [N] in Table 1's test."""
