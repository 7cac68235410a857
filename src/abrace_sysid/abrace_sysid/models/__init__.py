# SPDX-License-Identifier: Apache-2.0
"""State-space models from poles and transfer functions: superposed, consistent and reduced."""
