# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes: finding, parameters, starting, watching and stopping them, so that none is left behind."""
