# SPDX-License-Identifier: Apache-2.0
"""The operator's page in a browser, against running nodes; skipped where there is no Chromium."""

import pytest
from browser import CHROMIUM
from driven_browser import DrivenBrowser, Tab
from operator_page import page_address
from running_graph import stamp

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


def twice(tab: Tab, button: str) -> None:
    """Press a button that asks whether one is sure."""
    for _ in range(2):
        tab.click(button)


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
        tab.until("document.querySelectorAll('canvas').length === 3")
        tab.until_shown("#floors", "floor 3")

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
        assert {each.state for each in responses[before:]} == {Response.RUNNING}, "none of them has pressed"

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
            twice(tab, "#controls [data-do=clear]")
            tab.until_shown("#state", "running")

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
