# SPDX-License-Identifier: Apache-2.0
"""Choice of weights: takes models, ranges of weights and ground motions, gives responses and margins of each set."""
