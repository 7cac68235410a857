# SPDX-License-Identifier: Apache-2.0
"""From bags of white-noise tests to the state-space model of the actively braced building (Eqs. 1 to 10)."""

from abrace_core import public

__getattr__, __dir__ = public(__name__)
