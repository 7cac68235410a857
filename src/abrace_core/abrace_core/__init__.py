# SPDX-License-Identifier: Apache-2.0
"""The base of all packages: models with named signals, their simulation, safety checks, and the node conventions."""
