# SPDX-License-Identifier: Apache-2.0
"""The `abrace` command as a program."""

import os
import signal
import sys


def main() -> int:
    """Run the command; Ctrl-C ends it in silence while it imports, and is a KeyboardInterrupt then."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # nothing is open yet; the default one prints where in which import it came
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))

    from abrace.cli import main

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


if __name__ == "__main__":
    sys.exit(main())
