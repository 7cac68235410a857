# SPDX-License-Identifier: Apache-2.0
"""Linear models with named signals, their simulation, signals, noise, recorded tests, controllers."""
