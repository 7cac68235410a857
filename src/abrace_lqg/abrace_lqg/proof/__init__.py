# SPDX-License-Identifier: Apache-2.0
"""Proof of a design: takes a controller and models of the structure, gives checks, a table, figures and files."""
