# SPDX-License-Identifier: Apache-2.0
"""From bags of white-noise tests to the state-space model of the actively braced building (Eqs. 1 to 10)."""
