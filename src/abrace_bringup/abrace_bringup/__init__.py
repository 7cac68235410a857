# SPDX-License-Identifier: Apache-2.0
"""Launch files, and the tests that they start."""
