# SPDX-License-Identifier: Apache-2.0
"""The page in a browser, against running nodes; skipped where there is no Chromium."""

import re
import signal
import subprocess
import sys
import time

import pytest
from bag_of_run import write_bag
from browser import CHROMIUM
from driven_browser import DrivenBrowser, Tab
from operator_page import page_address
from running_graph import SLOW, stamp

from abrace import simulate
from abrace_core.files.installed import find_file
from abrace_core.model.table_signals import table_noise
from abrace_interfaces.msg import Response

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")

ATTACK = """(async () => {
  const found = {};
  const page = %r;
  try { await (await fetch(page)).text(); found.read = true; } catch { found.read = false; }
  await fetch(page + "live", { mode: "no-cors", method: "POST", body: '{"do": "stop"}' }).catch(() => 0);
  found.live = await new Promise((resolve) => {
    const socket = new WebSocket(page.replace("http", "ws") + "live");
    socket.onopen = () => { socket.send('{"token": ""}'); socket.send('{"do": "stop"}'); resolve(true); };
    socket.onerror = () => resolve(false);
  });
  return found;
})()"""


DRAWN = """(() => {
  const canvas = document.getElementById("building"), width = canvas.width;
  const pixels = canvas.getContext("2d").getImageData(0, 0, width, canvas.height).data;
  const greens = pixels.filter((value, index) => index % 4 === 1 && value > 100 && pixels[index - 1] < 60);
  return width > 0 && greens.length > 100;
})()"""
"""Whether the building is drawn, with a brace that is green: almost without force."""


def twice(tab: Tab, button: str) -> None:
    """Press a button that asks whether one is sure; it may have moved from under the mouse, as what is shown grows."""
    sure = f"document.querySelector({button!r})?.classList.contains('sure') ?? false"
    for asked in (True, False):
        for _ in range(10):
            tab.click(button)
            if tab.evaluate(sure) is asked:
                break
        else:
            raise AssertionError(f"{button} was not hit")


OUTSIDE = """[...document.querySelectorAll('button, input')].filter((each) => {
    const box = each.getBoundingClientRect();
    return box.width && (box.left < 0 || box.right > innerWidth);
}).map((each) => each.outerHTML)"""
"""The buttons that only sideways scrolling shows."""


def expect_fits_a_phone(tab: Tab) -> None:
    """360 px wide, no button is beyond the edge."""
    tab.command("Emulation.setDeviceMetricsOverride", width=360, height=740, deviceScaleFactor=2, mobile=False)
    tab.until("innerWidth === 360")
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert tab.evaluate(OUTSIDE) == []
    tab.command("Emulation.clearDeviceMetricsOverride")


def clear(tab: Tab) -> None:
    """As a person does: again where rest has not been measured yet."""
    for _ in range(10):
        twice(tab, "#controls [data-do=clear]")
        time.sleep(1.0)
        if "running" in tab.text("#state"):
            return
    tab.until_shown("#state", "running")


def test_a_person_arms_records_stops_and_clears_in_a_browser(graph):
    logger = graph.folder / "bag"
    responses = graph.listen(Response, "response")
    graph.start("plant", autostart=False)
    graph.start("logger", output=str(logger), autostart=False)
    graph.start("operator", port=0, page_heartbeat=5.0)
    address = page_address(graph)
    port = address.rstrip("/").rpartition(":")[2]
    with DrivenBrowser("--host-resolver-rules=MAP attacker.example 127.0.0.1") as browser:
        tab = browser.open(address)
        tab.until_shown("#state", "no samples")
        tab.until_shown("#cause", "STOP on the page: no page has been opened yet")
        twice(tab, "#release")
        tab.until_shown("#events", "STOP released")
        # the rig was stopped before it was configured
        tab.until("document.querySelector('#nodes [data-do=clear]') !== null")
        twice(tab, "#controls [data-do=clear]")
        tab.until_shown("#events", "plant: cleared")
        twice(tab, "[data-do=arm]")
        tab.until_shown("#state", "ncree_three_storey: running")
        tab.click("[data-do=record]")
        tab.until_shown("#recording", "recording")
        tab.until("document.querySelectorAll('canvas').length === 4")
        tab.until_shown("#floors", "floor 3")
        tab.until(DRAWN)

        # another page in the same browser, under a name of its own and under one that leads here
        graph.until(lambda: responses and responses[-1].state == Response.RUNNING, "the rig to run")
        before = len(responses)
        other = browser.open("data:text/html,<p>somebody else's")
        assert other.evaluate(ATTACK % address) == {"read": False, "live": False}
        rebound = browser.open(f"http://attacker.example:{port}/")
        rebound.until_shown("body", "403")
        assert rebound.evaluate(ATTACK % f"http://attacker.example:{port}/")["live"] is False
        framed = browser.open(f"data:text/html,<iframe src={address}></iframe>")
        in_frame = graph.until(lambda: [one for one in browser.frames() if one != "about:blank"], "the frame")
        assert in_frame == ["chrome-error://chromewebdata/"], "a page that is framed could be had clicked"
        for each in (other, rebound, framed):
            each.close()
        attacked = graph.node.get_clock().now().nanoseconds
        graph.until(lambda: stamp(responses[-1]) > attacked, "a sample from after the attacks")
        assert not any(each.cause for each in responses[before:]), "none of them has pressed"

        # by mouse from the end of the page, by keys wherever the focus is
        for press in (
            lambda: tab.click("#stop"),
            lambda: (tab.evaluate("document.querySelector('[data-do=arm]').focus()"), tab.press(" ")),
            lambda: tab.press("Escape"),
        ):
            tab.evaluate("scrollTo(0, 1e6)")
            press()
            graph.until(lambda: responses[-1].state == Response.PROTECTIVE_STOP, "the protective stop")
            tab.until_shown("#cause", "pressed by ")
            tab.until_shown("#stop-note", "PRESSED")
            twice(tab, "#release")
            tab.until_shown("#state", "latched")
            clear(tab)

        expect_fits_a_phone(tab)
        tab.click("[data-do=end_record]")
        tab.until_shown("#events", "wrote ")
        assert (logger / "metadata.yaml").is_file()
        assert tab.errors == []
        tab.close()
        graph.until(lambda: responses[-1].state == Response.PROTECTIVE_STOP, "a lost page to be a stop")
        tab = browser.open(address)
        tab.until_shown("#cause", "a page was closed")
        assert graph.stop("operator") == 0
        tab.until_shown("#alarm", "NO CONNECTION")
        tab.click("#stop")
        tab.until_shown("#alarm", "STOP was pressed: it is sent as soon as the connection is back")


@pytest.mark.alone
def test_arming_moves_nothing_and_a_signal_plays_when_its_button_is_pressed_also_after_a_stop(graph):
    responses = graph.listen(Response, "response")
    graph.by_the_clock, rig = True, graph.slow_rig()
    graph.start("plant", rig=rig, autostart=False, command_timeout=1.0, late_limit=1000)
    graph.start("excitation", sample_rate=SLOW, duration=600.0, rms=500.0, band=[0.5, 20.0])
    graph.start("operator", port=0, rig=rig)
    address, play = page_address(graph), "#nodes [data-do=play]"

    def pushes(since: int) -> bool:
        return any(abs(one.command[0]) > 100.0 for one in responses[since:])

    with DrivenBrowser() as browser:
        tab = browser.open(address)
        tab.until_shown("#state", "no samples")
        tab.until_shown("#nodes", "plant")
        twice(tab, "#controls [data-do=arm]")
        tab.until_shown("#state", "running")
        tab.until(f"document.querySelector('{play}') !== null")
        graph.until(lambda: len(responses) > 2 * SLOW, "2 s")
        assert not pushes(0)
        twice(tab, play)
        graph.until(lambda: pushes(0), "the braces to push")
        tab.until(f"document.querySelector('{play}') === null")
        tab.click("#stop")
        tab.until_shown("#nodes", "cancelled: protective stop")
        twice(tab, "#release")
        tab.until_shown("#state", "latched")
        clear(tab)
        # we have not received while we looked at the page
        latched = Response.LATCHED
        graph.until(lambda: any(one.state == latched for one in responses), "the stop")
        graph.until(lambda: responses[-1].state == Response.RUNNING, "the fade to end")
        cleared = len(responses)
        graph.until(lambda: len(responses) > cleared + SLOW, "a second")
        assert not pushes(cleared)
        tab.until(f"document.querySelector('{play}') !== null")
        twice(tab, play)
        graph.until(lambda: pushes(cleared), "the braces to push again")


def test_a_page_that_only_watches_shows_the_rig_and_presses_nothing(graph):
    responses = graph.listen(Response, "response")
    graph.start("plant")
    token = graph.folder / "token"
    token.write_text("0123456789abcdef")
    token.chmod(0o600)
    graph.start("operator", port=0, token_file=str(token))
    address = page_address(graph)
    with DrivenBrowser() as browser:
        tab = browser.open(address)
        tab.until_shown("#state", "ncree_three_storey: running")
        tab.until(DRAWN)
        tab.until_shown("#enter", "This page only watches: it has no STOP.")
        assert tab.evaluate("['stop', 'controls'].every((id) => document.getElementById(id).offsetParent === null)")
        tab.until("document.querySelectorAll('#nodes tr').length > 2")
        assert tab.evaluate("document.querySelector('#nodes button')") is None
        for key in (" ", "Escape"):
            tab.press(key)
        tab.evaluate("send({ do: 'stop' })")
        graph.until(lambda: "page that only watches" in graph.values("operator").get("last refusal", ""), "a refusal")
        assert not any(each.cause for each in responses[-10:])

        # the keyboard alone: to the token, to STOP, to its release
        tab.evaluate("document.getElementById('token').focus()")
        tab.command("Input.insertText", text="0123456789abcdef")
        tab.press("Enter")
        tab.until("document.getElementById('stop').offsetParent !== null")
        tab.press(" ")
        graph.until(lambda: responses[-1].state == Response.PROTECTIVE_STOP, "the protective stop")
        tab.until("document.getElementById('release').offsetParent !== null")
        tab.evaluate("document.getElementById('release').focus()")
        for _ in range(2):
            tab.press("Enter")
        graph.until(lambda: responses[-1].state == Response.LATCHED, "STOP to be released")
        assert tab.errors == []
    assert graph.stop("operator") == 0


WATCH = "import sys; from pathlib import Path; from abrace.processes.watching import watch_bag; "
WATCH += "watch_bag(Path('noise'), '', Path(sys.argv[1]), ['port:=0'])"


def test_a_bag_is_played_again_and_again_and_commands_nothing(graph, monkeypatch):
    monkeypatch.chdir(graph.folder)
    write_bag(simulate("ncree_three_storey", table_noise(1500, 500.0, (0.5, 10.0), 0.3, 1)), "noise")
    rig = find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig")
    starts = [sys.executable, "-c", WATCH, str(rig)]
    with DrivenBrowser() as browser, subprocess.Popen(starts, stderr=subprocess.PIPE, text=True) as watching:
        try:
            tab = browser.open(re.match(r"watch: (\S+) plays noise", watching.stderr.readline())[1])
            for words in ("unconfigured", "no samples", "unconfigured"):
                tab.until_shown("#state", words)
            tab.until(DRAWN)
            assert tab.evaluate("document.getElementById('stop').offsetParent === null")
            graph.until(
                lambda: graph.node.count_publishers("/watched_bag/response"), "the samples under their own name"
            )
            assert not graph.node.count_publishers("/response")
            assert not graph.node.count_publishers("/emergency_stop")
        finally:
            watching.send_signal(signal.SIGINT)
        assert watching.wait(30) == 0
