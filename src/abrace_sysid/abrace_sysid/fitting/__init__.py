# SPDX-License-Identifier: Apache-2.0
"""Transfer functions and spectra to poles, with their confidence intervals."""
