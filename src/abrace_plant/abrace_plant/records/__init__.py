# SPDX-License-Identifier: Apache-2.0
"""Ground motion records: takes files of many formats, gives accelerations for the table, intensity and spectra."""
