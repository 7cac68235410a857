"""Launch files, and the tests that they start."""
