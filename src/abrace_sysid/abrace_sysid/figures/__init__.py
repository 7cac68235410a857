# SPDX-License-Identifier: Apache-2.0
"""Figures of identifications and validations; `abrace_core.figures.drawing` has the colours and saves figures."""
