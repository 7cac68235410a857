# SPDX-License-Identifier: Apache-2.0
"""Batches of work: takes a function and batches, gives their results as Parquet files, however they are computed."""
