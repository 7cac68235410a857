# SPDX-License-Identifier: Apache-2.0
"""Executables: take parameters and topics, give controller files and brace commands; one module for each."""
