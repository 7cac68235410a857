# SPDX-License-Identifier: Apache-2.0
"""The operator's page: samples and reports of a running rig to a page in the browser, and what is pressed there."""
