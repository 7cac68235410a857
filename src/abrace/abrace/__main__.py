# SPDX-License-Identifier: Apache-2.0
"""The `abrace` command as a program."""

import os
import signal
from typing import NoReturn


def main() -> NoReturn:
    """Run the command; Ctrl-C ends it in silence while it imports, and is a KeyboardInterrupt then."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # nothing is open yet; the default one prints where in which import it came
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))

    from abrace.cli import main
    from abrace_node.executable import leave

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    leave(main())


if __name__ == "__main__":
    main()
