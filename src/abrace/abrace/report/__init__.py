# SPDX-License-Identifier: Apache-2.0
"""The results and bags of a campaign to report.html, summary.json and tables."""
