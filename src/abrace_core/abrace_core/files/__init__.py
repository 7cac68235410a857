# SPDX-License-Identifier: Apache-2.0
"""Reading and writing the files that people write: checked key by key, written atomically, one set of messages."""
