# SPDX-License-Identifier: Apache-2.0
"""Studies of many closed loops: sets of weights, fragility, benchmark buildings. Nothing below needs this package."""

from abrace_core import public

__getattr__, __dir__ = public(__name__)
