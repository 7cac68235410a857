# SPDX-License-Identifier: Apache-2.0
"""Controllers for other targets: C99 sources, and a co-simulation unit (FMI 2.0) made of them."""
