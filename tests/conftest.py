# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests."""

import signal

from hypothesis import settings

# no test asks for speed: an example may take as long as a busy machine needs
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# a script's shell starts what runs in the background with SIGINT ignored, and every process that a test starts would be
signal.signal(signal.SIGINT, signal.default_int_handler)
