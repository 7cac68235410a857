# SPDX-License-Identifier: Apache-2.0
"""Real hardware: takes a device file, gives a device that takes commands and answers with one reading a tick."""
