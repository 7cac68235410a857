# SPDX-License-Identifier: Apache-2.0
"""Progress: a bar in place on a terminal, few plain lines elsewhere."""

import io
import re
import time

import pytest

from abrace_core.files.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_log_gets_a_line_every_ten_seconds_and_one_at_the_end():
    log, now = io.StringIO(), [0.0]
    with Progress(3, log, lambda: now[0]).step("table_noise") as step:
        for second in range(26):
            now[0] = float(second)
            step.update(second / 25, "6.3 x real time")
    assert log.getvalue().splitlines() == [
        "[1/3] table_noise: 40% in 0:10, 6.3 x real time",
        "[1/3] table_noise: 80% in 0:20, 6.3 x real time",
        "[1/3] table_noise: done in 0:25, 6.3 x real time",
    ]


def test_a_terminal_gets_a_bar_that_goes_and_one_line_that_stays(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    terminal, now = Terminal(), [0.0]
    with Progress(2, terminal, lambda: now[0]).step("model") as step:
        now[0] = 65.0
        step.update(0.5, "2.0 x real time")
        time.sleep(0.3)  # it is drawn ten times a second
        drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue())
        assert re.search(r"\[1/2\] model .* 50% 0:01:05 2\.0 x real time", drawn)
        step.update(None)
        now[0] = 66.0
    assert terminal.getvalue().endswith("[1/2] model: done in 1:06, 2.0 x real time\n")
    assert "\x1b[2K" in terminal.getvalue(), "the bar should have been cleared"


@pytest.mark.parametrize(("error", "outcome"), [(ValueError, "failed after"), (KeyboardInterrupt, "stopped after")])
def test_a_step_that_does_not_end_well_says_so(error, outcome):
    def run() -> None:
        with Progress(1, log, lambda: 0.0).step("model"):
            raise error

    log = io.StringIO()
    with pytest.raises(error):
        run()
    assert log.getvalue() == f"[1/1] model: {outcome} 0:00\n"
