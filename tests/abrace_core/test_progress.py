# SPDX-License-Identifier: Apache-2.0
"""Progress: a bar in place on a terminal, few plain lines elsewhere."""

import io
import os

import pytest

from abrace_core.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    def screen(self) -> list[str]:
        """Lines as one sees them: each carriage return overwrites."""
        return [line.split("\r")[-1].replace("\x1b[K", "") for line in self.getvalue().split("\n")]


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


def test_a_terminal_gets_a_bar_in_place_and_one_line_that_stays(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    terminal, now = Terminal(), [0.0]
    progress = Progress(2, terminal, lambda: now[0])
    with progress.step("model") as step:
        now[0] = 65.0
        step.update(0.5, "2.0 x real time")
        assert terminal.screen() == ["[1/2] model  ############............  50%  1:05, 2.0 x real time"]
        now[0] = 66.0
        step.update(None)
        assert terminal.screen() == ["[1/2] model  1:06, 2.0 x real time"]
    with progress.step("lqg3"):
        assert terminal.screen()[-1] == "[2/2] lqg3  0:00"
    assert terminal.screen() == ["[1/2] model: done in 1:06, 2.0 x real time", "[2/2] lqg3: done in 0:00", ""]


def test_the_bar_never_wraps_and_is_not_drawn_at_every_update(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("shutil.get_terminal_size", lambda: os.terminal_size((30, 24)))
    terminal, now = Terminal(), [0.0]
    with Progress(1, terminal, lambda: now[0]).step("a_step_with_quite_a_long_name") as step:
        for k in range(1001):
            now[0] = k / 1000
            step.update(k / 1000)
        assert max(map(len, terminal.screen())) < 30
    assert 9 <= terminal.getvalue().count("\r") <= 12, "about one drawing in 0.1 s"


@pytest.mark.parametrize(("error", "outcome"), [(ValueError, "failed after"), (KeyboardInterrupt, "stopped after")])
def test_a_step_that_does_not_end_well_says_so(error, outcome):
    def run() -> None:
        with Progress(1, log, lambda: 0.0).step("model"):
            raise error

    log = io.StringIO()
    with pytest.raises(error):
        run()
    assert log.getvalue() == f"[1/1] model: {outcome} 0:00\n"
