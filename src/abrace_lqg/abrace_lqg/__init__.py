# SPDX-License-Identifier: Apache-2.0
"""From models to LQG controllers: weights, design, analysis of the closed loop, proof, and the law at run time."""

from abrace_core import public

__getattr__, __dir__ = public(__name__)
