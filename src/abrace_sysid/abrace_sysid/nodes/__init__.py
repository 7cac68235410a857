# SPDX-License-Identifier: Apache-2.0
"""The nodes: parameters, topics, callbacks and `main`, one module for each executable."""
