# SPDX-License-Identifier: Apache-2.0
"""The results and bags of a campaign to report.html, report.md, summary.json and tables; the building in motion."""
