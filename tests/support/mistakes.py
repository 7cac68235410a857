# SPDX-License-Identifier: Apache-2.0
"""Runs commands as processes of their own, quickly: their modules are imported once, then each command is forked.

`python mistakes.py MODULE ...` takes a line of JSON for each command, [word, ...], and gives [code, output, errors].
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import tempfile
import traceback

PATIENCE = 10


def become(words: list[str]) -> int:
    """The exit code of `abrace ...`, or of `package/node ...`."""
    package, _, name = words[0].rpartition("/")
    sys.argv = [f"lib/{package}/{name}" if package else name, *words[1:]]
    module = importlib.import_module(f"{package}.nodes.{name}" if package else "abrace.cli")
    return int(module.main())


def child(words: list[str], output: int, errors: int) -> None:
    """Run a command in this process, which ends with the command's exit code."""
    code = 1
    try:
        signal.alarm(PATIENCE)
        os.dup2(output, 1)
        os.dup2(errors, 2)
        code = become(words)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def run(words: list[str]) -> list:
    """Exit code, output and errors of a command."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = os.fork()
        if not process:
            child(words, output.fileno(), errors.fileno())
        _, status = os.waitpid(process, 0)
        texts = []
        for file in (output, errors):
            file.seek(0)
            texts.append(file.read().decode())
        return [os.waitstatus_to_exitcode(status), *texts]


def main() -> None:
    """Answer the commands, in their order."""
    for module in sys.argv[1:]:
        importlib.import_module(module)
    for line in sys.stdin:
        print(json.dumps(run(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
