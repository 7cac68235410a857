"""The files of results that a campaign wrote, to summary.json, report.md and tables."""
