# SPDX-License-Identifier: Apache-2.0
"""Matplotlib figures of identifications and validations; `abrace_core.drawing` has the colours and saves figures."""
