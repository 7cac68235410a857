# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests."""

from hypothesis import settings

# no test asks for speed: an example may take as long as a busy machine needs
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
