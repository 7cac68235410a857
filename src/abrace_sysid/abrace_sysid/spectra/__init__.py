# SPDX-License-Identifier: Apache-2.0
"""Transfer functions and their noise, estimated from time histories."""
