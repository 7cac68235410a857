# SPDX-License-Identifier: Apache-2.0
"""What `import abrace` gives: the libraries, with arguments by name or file, and results that show themselves."""
