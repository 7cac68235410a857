# SPDX-License-Identifier: Apache-2.0
"""A campaign file to the bags, models, controllers and comparisons of its steps."""
