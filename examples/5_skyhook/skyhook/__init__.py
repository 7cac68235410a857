# SPDX-License-Identifier: Apache-2.0
"""A skyhook damper as a control law of one's own."""
