# SPDX-License-Identifier: Apache-2.0
"""The laboratory: building, braces, records, sensors, and the nodes that run them."""

from abrace_core import public

__getattr__, __dir__ = public(__name__)
