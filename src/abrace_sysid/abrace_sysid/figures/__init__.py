# SPDX-License-Identifier: Apache-2.0
"""Identifications and validations to matplotlib Figures; `abrace_core.drawing` has the colours and saves them."""
