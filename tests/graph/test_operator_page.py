# SPDX-License-Identifier: Apache-2.0
"""The page in a browser, against running nodes; skipped where there is no Chromium."""

import re
import signal
import subprocess
import sys
import time

import pytest
import rclpy
from bag_of_run import write_bag
from browser import CHROMIUM
from driven_browser import DrivenBrowser, Tab
from operator_page import page_address
from running_graph import LATCHED, SLOW, stamp
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

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


UNUSABLE = """(async () => {
  const found = [], note = (what, each) => found.push(`${what}: ${each.outerHTML.slice(0, 200)}`);
  const shown = (selector) => [...document.querySelectorAll(selector)].filter((each) => each.getClientRects().length);
  await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  if (Math.max(innerWidth, document.documentElement.scrollWidth) > 360) found.push("the page scrolls sideways");
  for (const each of shown("button, input, a[href]")) {
    const box = each.getBoundingClientRect();
    if (box.left < 0 || box.right > 360) note("beyond the edge", each);
    if (box.width < 44 || box.height < 44) note("too small for a finger", each);
  }
  for (const each of shown("#state, #cause, #alarm, section, td, li, p, button")) {
    if (each.scrollWidth > each.clientWidth + 1) note("cut off", each);
  }
  for (const each of shown("#state, #cause, button")) {
    if (each.scrollHeight > each.clientHeight + 1) note("cut off below", each);
  }
  scrollTo(0, document.documentElement.scrollHeight);
  for (const each of shown("#stop")) {
    const box = each.getBoundingClientRect();
    const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
    if (!each.contains(at) || box.bottom > 740) note("out of sight", each);
  }
  scrollTo(0, 0);
  return found;
})()"""
"""What cannot be read or pressed on a telephone of 360 by 740 px."""


def expect_fits_a_phone(tab: Tab) -> None:
    """On 360 by 740 px nothing is beyond the edge, cut off or too small, and STOP stays in sight."""
    tab.command("Emulation.setDeviceMetricsOverride", width=360, height=740, deviceScaleFactor=2, mobile=True)
    tab.until("screen.width === 360")
    assert tab.evaluate(UNUSABLE) == []
    tab.command("Emulation.clearDeviceMetricsOverride")
    tab.until("innerWidth > 360")


FOCUSED = """(() => {
  const each = document.activeElement, box = each.getBoundingClientRect();
  if (each === document.body) return null;
  const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
  const name = each.id || [each.dataset.do, each.dataset.node].filter(Boolean).join(" ") || each.innerText.trim();
  return { name, seen: each.contains(at) && getComputedStyle(each).outlineStyle !== "none" };
})()"""
"""What is in focus, and whether a person sees that it is."""
MOST_TABS = 40


def tab_to(tab: Tab, name: str) -> list[str]:
    """Press Tab until it brings this into focus; returns all that was in focus on the way."""
    passed: list[str] = []
    for _ in range(MOST_TABS):
        tab.press("Tab")
        focused = tab.evaluate(FOCUSED)
        if focused is None:
            continue  # the browser's own buttons
        assert focused["seen"], f"{focused['name']} has the focus, and nobody sees it"
        passed.append(focused["name"])
        if focused["name"] == name:
            return passed
    raise AssertionError(f"no key leads to {name}, only to {passed}")


def enter_twice(tab: Tab, name: str) -> list[str]:
    """By keys to a button that asks whether one is sure, and press it."""
    passed = tab_to(tab, name)
    for _ in range(2):
        tab.press("Enter")
    return passed


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
        expect_fits_a_phone(tab)
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
        for button in ("arm", "zero", "clear"):
            tab.evaluate(f"document.querySelector('#controls [data-do={button}]').click()")
        expect_fits_a_phone(tab)

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
            expect_fits_a_phone(tab)
            twice(tab, "#release")
            tab.until_shown("#state", "latched")
            expect_fits_a_phone(tab)
            clear(tab)

        # a long cause
        name = "button_" + 8 * "of_another_laboratory_"
        silent = {"start_parameter_services": False, "enable_rosout": False}  # whose topics would have too long names
        stranger = rclpy.create_node(name, context=graph.node.context, **silent)
        stranger.create_publisher(Bool, "/emergency_stop", LATCHED).publish(Bool(data=True))
        tab.until_shown("#cause", name)
        expect_fits_a_phone(tab)
        stranger.destroy_node()
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
        expect_fits_a_phone(tab)


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
        expect_fits_a_phone(tab)
        tab.click("#stop")
        tab.until_shown("#nodes", "cancelled: protective stop")
        expect_fits_a_phone(tab)
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
        expect_fits_a_phone(tab)
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


@pytest.mark.alone
def test_the_keyboard_alone_operates_the_rig_and_no_key_held_down_or_hit_by_chance_moves_it(graph):
    responses = graph.listen(Response, "response")
    graph.by_the_clock, rig, token = True, graph.slow_rig(), graph.folder / "token"
    token.write_text("0123456789abcdef")
    token.chmod(0o600)
    graph.start("plant", rig=rig, autostart=False, command_timeout=1.0, late_limit=1000)
    graph.start("excitation", sample_rate=SLOW, duration=600.0, rms=500.0, band=[0.5, 20.0])
    graph.start("operator", port=0, rig=rig, token_file=str(token))
    excitation, plant = (f"{graph.namespace}/{name}" for name in ("excitation", "plant"))

    def button(action: str, node: str) -> str:
        return f"""document.querySelector('#nodes [data-do={action}][data-node="{node}"]')"""

    with DrivenBrowser() as browser:
        tab = browser.open(page_address(graph))
        tab.until_shown("#enter", "This page only watches")
        tab_to(tab, "token")
        tab.command("Input.insertText", text="0123456789abcdef")
        tab.press("Enter")
        for each in (button("play", excitation), button("arm", plant)):
            tab.until(f"{each} !== null")
        for key in "abcdefghijklmnopqrstuvwxyz0123456789":
            tab.press(key)
        assert tab.evaluate("document.querySelector('.sure')") is None
        tab_to(tab, "stop")
        rows = [f"disarm {excitation}", f"play {excitation}", f"arm {plant}"]
        controls = ["arm", "disarm", "record", "end_record", "zero", "clear"]
        assert tab_to(tab, "stop") == [*controls, "exaggeration", *rows, "Foxglove", "stop"]

        # a button that the header covers comes out from under it
        tab.evaluate("scrollBy(0, document.querySelector('[data-do=arm]').getBoundingClientRect().top)")
        tab.until("document.querySelector('[data-do=arm]').getBoundingClientRect().top < 1")
        tab_to(tab, "arm")
        tab.press("Enter", repeats=5)
        tab.until_shown("#controls", "Press again: Arm the rig")
        tab.press("Enter")
        tab.until_shown("#state", "running")

        # a row that changes keeps the focus where it is
        tab_to(tab, f"disarm {excitation}")
        assert graph.call(Trigger, "excitation/play", Trigger.Request()).success
        tab.until(f"{button('play', excitation)} === null")
        assert tab.evaluate(FOCUSED)["name"] == f"disarm {excitation}"
        graph.until(lambda: abs(responses[-1].command[0]) > 100.0, "the braces to push")
        tab.press("Enter")
        tab.until_shown("#nodes", "cancelled: ")
        tab.until(f"{button('arm', excitation)} !== null")
        # a button that is gone leaves the focus on its row, and on no other button
        assert tab.evaluate("document.activeElement.tagName") == "TR"
        assert enter_twice(tab, f"arm {excitation}") == [f"arm {excitation}"]
        tab.until(f"{button('play', excitation)} !== null")
        started = len(responses)
        assert enter_twice(tab, f"play {excitation}") == [f"disarm {excitation}", f"play {excitation}"]
        graph.until(lambda: any(abs(one.command[0]) > 100.0 for one in responses[started:]), "the braces to push")

        tab_to(tab, "stop")
        tab.press("Enter")
        tab.until_shown("#state", "protective stop")
        assert tab.evaluate("document.querySelector('#cause [role=alert]').innerText").startswith("protective stop")
        enter_twice(tab, "release")
        tab.until_shown("#state", "latched")
        tab.until("document.getElementById('release').offsetParent === null")
        assert tab.evaluate("document.activeElement.id") == "controls"
        assert tab_to(tab, "clear") == controls
        for _ in range(10):  # again where rest has not been measured yet
            shown = tab.evaluate("document.querySelectorAll('#events li').length")
            for _ in range(2):
                tab.press("Enter")
            tab.until(f"document.querySelectorAll('#events li').length > {shown}")
            if "plant: cleared" in tab.text("#events li"):
                break
        tab.until_shown("#state", "running")
        unnamed = "[...document.querySelectorAll('#nodes button')].filter((each) => !each.ariaLabel).length"
        assert tab.evaluate(unnamed) == 0


LIGHT_GREY = """(() => {
  const canvas = document.getElementById("building");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  for (let at = 0; at < pixels.length; at += 4) {
    if (pixels[at] === 0xb8 && pixels[at + 1] === 0xbf && pixels[at + 2] === 0xc6) return true;
  }
  return false;
})()"""
"""Whether a floor is drawn as one without displacement sensor."""
STILL, BETWEEN = "No displacement is measured", "Floors in light grey"


@pytest.mark.parametrize(
    ("rig", "channels", "floors", "charts", "note"),
    [
        ("six_storey", None, [6, 4, 2], 2, STILL),
        ("ncree_three_storey", {"acceleration": "[a1, a2, a3]"}, [3, 2, 1], 2, STILL),
        ("ncree_three_storey", {"displacement": "[x1, x3]", "acceleration": "[a3]"}, [3, 1], 3, BETWEEN),
        ("five_storey", None, [5, 4, 3, 2, 1], 3, ""),
    ],
    ids=["accelerations of some floors", "accelerations alone", "displacements of some floors", "all, two groups"],
)
def test_what_is_not_measured_is_not_shown(graph, rig, channels, floors, charts, note):
    if channels is not None:
        text = find_file(rig, "abrace_plant", "config", ".yaml", "rig").read_text()
        for kind in ("displacement", "stroke", "acceleration"):
            only = f"  {kind}: {{channels: {channels[kind]}, range" if kind in channels else f"  # {kind}: {{range"
            text, replaced = re.subn(rf"(?m)^  {kind}: \{{range", only, text)
            assert replaced == 1
        rig = str(graph.folder / "some_sensors.yaml")
        (graph.folder / "some_sensors.yaml").write_text(text)
    graph.start("plant", rig=rig)
    graph.start("operator", port=0, rig=rig)
    with DrivenBrowser() as browser:
        tab = browser.open(page_address(graph))
        tab.until_shown("#state", "running")
        tab.until(f"document.querySelectorAll('#floors tbody tr').length === {len(floors)}")
        tab.until(DRAWN)
        rows = tab.evaluate("[...document.querySelectorAll('#floors tbody tr')].map((row) => row.cells[0].innerText)")
        assert rows == [f"floor {number}" for number in floors]
        shown = "[...document.querySelectorAll('.trace canvas')].filter((each) => each.offsetParent).length"
        assert tab.evaluate(shown) == charts
        moving = note != STILL
        for element in ("displacement-trace", "exaggeration"):
            assert tab.evaluate(f"document.getElementById('{element}').offsetParent !== null") is moving
        assert tab.text("#floors thead").startswith("floor\tdisplacement" if moving else "floor\tacceleration")
        assert tab.text("#not-measured").startswith(note)
        assert tab.evaluate(LIGHT_GREY) is bool(note)
        assert not re.search("NaN|undefined|Infinity|null", tab.text())
        expect_fits_a_phone(tab)
        assert tab.errors == []


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
            expect_fits_a_phone(tab)
            assert tab.evaluate("document.getElementById('stop').offsetParent === null")
            graph.until(
                lambda: graph.node.count_publishers("/watched_bag/response"), "the samples under their own name"
            )
            assert not graph.node.count_publishers("/response")
            assert not graph.node.count_publishers("/emergency_stop")
        finally:
            watching.send_signal(signal.SIGINT)
        assert watching.wait(30) == 0
