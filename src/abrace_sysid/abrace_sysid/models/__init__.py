# SPDX-License-Identifier: Apache-2.0
"""Poles and transfer functions to state-space models: superposed, consistent or reduced."""
