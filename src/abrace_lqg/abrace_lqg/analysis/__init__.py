# SPDX-License-Identifier: Apache-2.0
"""Closed-loop analysis: takes a model and a controller, gives stability margins, modal damping, predicted rms."""
