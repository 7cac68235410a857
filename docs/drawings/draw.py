# SPDX-License-Identifier: Apache-2.0
"""Draws the diagrams of the documentation into docs/figures: `python docs/drawings/draw.py`."""

from __future__ import annotations

import json
from itertools import takewhile
from pathlib import Path
from typing import Any

from svg import BLUE, GREEN, GREY, INK, RED, Drawing

from abrace_bringup.viewing.layout import foxglove_layout

DOCS = Path(__file__).parents[1]
FIGURES = DOCS / "figures"
WHITE, ROSE, MINT, SAND = "#ffffff", "#fbe9e7", "#e8f5e9", "#fff8e1"


def rig() -> Drawing:
    """Building, table, a brace with its actuator, the sensors and their positive directions."""
    drawing = Drawing(840, 470)
    left, right, ground = 200, 480, 400
    heights = [290, 190, 90]
    drawing.box(130, ground, 420, 24, "table", fill="#dde3ea")
    for x in (left, right):
        drawing.line((x, ground), (x, heights[-1]), width=5, edge="#555555")
    for number, y in enumerate(heights, 1):
        drawing.box(left - 14, y - 9, right - left + 28, 18, f"floor {number}", fill="#dde3ea")
        drawing.arrow((right + 22, y), (right + 82, y), edge=BLUE, width=2)
        drawing.words(right + 92, y, f"x{number}  displacement relative to the table", anchor="start", colour=BLUE)
        drawing.box(left - 62, y - 11, 34, 22, f"a{number}", fill=SAND)
        drawing.arrow((left - 112, y), (left - 66, y), edge=RED, width=2)
    drawing.words(20, 52, "a1 to a3  absolute acceleration", colour=RED, anchor="start")
    # brace from the table, lower left, to floor 1, upper right: extending pushes the floor to +x
    drawing.line((left + 12, ground - 4), (right - 14, heights[0] + 12), width=6, edge="#555555")
    drawing.line((left + 96, ground - 36), (left + 156, ground - 58), width=16, edge=GREEN)
    drawing.circle(left + 12, ground - 4, 5)
    drawing.circle(right - 14, heights[0] + 12, 5)
    drawing.arrow((left + 160, ground - 82), (left + 214, ground - 102), edge=GREEN, width=2)
    drawing.words(left + 92, ground - 70, "actuator extends", colour=GREEN)
    text = "xf  stroke;  fa, fb  force;  U  command:\npositive when the actuator extends\nand pushes its floor to +x"
    drawing.words(right + 22, ground - 48, text, anchor="start", colour=GREEN)
    drawing.arrow((300, ground + 44), (400, ground + 44), edge=RED, width=2)
    drawing.words(410, ground + 44, "w  acceleration of the table, absolute", anchor="start", colour=RED)
    drawing.arrow((40, ground + 44), (110, ground + 44), width=2)
    drawing.words(75, ground + 28, "+x", bold=True)
    return drawing


def graph() -> Drawing:
    """Nodes and topics, live and offline."""
    drawing = Drawing(820, 410)
    drawing.words(20, 22, "live, 500 times a second", anchor="start", bold=True)
    drawing.box(20, 60, 140, 44, "ground_motion")
    drawing.box(300, 50, 180, 64, "plant (simulated) or\nsensor_bridge\n(hardware)", fill=SAND)
    drawing.box(640, 50, 160, 64, "controller\n(in tests:\nexcitation)")
    drawing.arrow((160, 72), (298, 72), edge=RED)
    drawing.words(229, 58, "ground_motion", colour=RED)
    drawing.arrow((298, 94), (162, 94), edge=BLUE)
    drawing.words(229, 108, "response", colour=BLUE)
    drawing.arrow((480, 72), (638, 72), edge=BLUE)
    drawing.words(559, 58, "response", colour=BLUE)
    drawing.arrow((638, 94), (482, 94), edge=RED)
    drawing.words(559, 108, "brace_command", colour=RED)
    drawing.box(20, 180, 160, 44, "operator page,\nabrace stop")
    drawing.arrow((100, 178), (100, 146), (340, 146), (340, 116), edge=RED, dashed=True)
    drawing.words(215, 134, "/emergency_stop", colour=RED)
    drawing.box(360, 180, 150, 44, "logger")
    drawing.arrow((435, 116), (435, 178), edge=GREY, dashed=True)
    drawing.words(445, 146, "all topics", colour=GREY, anchor="start")
    drawing.line((20, 250), (800, 250), edge=GREY, dashed=True)
    drawing.words(20, 272, "offline", anchor="start", bold=True)
    drawing.arrow((435, 226), (435, 298), edge=BLUE)
    drawing.words(445, 276, "bags", anchor="start", colour=BLUE)
    drawing.box(360, 300, 150, 44, "identify")
    drawing.arrow((510, 322), (638, 322))
    drawing.words(574, 308, "model")
    drawing.box(640, 300, 160, 44, "design")
    drawing.arrow((720, 300), (720, 116), edge=GREEN)
    drawing.words(712, 210, "controller file", anchor="end", colour=GREEN)
    drawing.box(140, 300, 150, 44, "validate")
    drawing.arrow((360, 322), (292, 322))
    drawing.words(325, 308, "model")
    drawing.arrow((400, 226), (400, 262), (215, 262), (215, 298), edge=BLUE)
    drawing.words(215, 366, "is the model right?", colour=GREY)
    return drawing


def sample() -> Drawing:
    """A time line of three samples: readings, answers, when they act, when they are recorded."""
    drawing = Drawing(860, 336)
    start, period = 140, 250
    for number in range(3):
        x = start + number * period
        drawing.line((x, 40), (x, 292), edge=GREY, dashed=True)
        drawing.words(x, 26, f"sample k{'+' + str(number) if number else ''}", bold=True)
    names = ["rig", "controller", "force that acts"]
    for row, name in enumerate(names):
        drawing.words(16, 84 + 88 * row, name, anchor="start")
    drawing.line((start, 84), (840, 84))
    drawing.line((start, 172), (840, 172))
    drawing.circle(start, 84, 5, fill=BLUE)
    drawing.arrow((start, 84), (start + 40, 168), edge=BLUE)
    drawing.words(start + 8, 64, "readings: response k", anchor="start", colour=BLUE)
    drawing.box(start + 42, 160, 50, 24, "law", fill=SAND)
    drawing.arrow((start + 92, 170), (start + 128, 88), edge=RED)
    drawing.words(start + 126, 126, "answer k", anchor="start", colour=RED)
    limit = start + 0.8 * period
    drawing.line((limit, 70), (limit, 100), edge=RED, width=3)
    drawing.words(limit - 2, 58, "0.8 period", colour=RED)
    drawing.line((start, 276), (start + period, 276), (start + period, 248), (start + 2 * period, 248),
                 (start + 2 * period, 262), (840, 262), width=3, edge=GREEN)  # fmt: skip
    drawing.words(start + 1.5 * period, 234, "the force of answer k acts", colour=GREEN)
    drawing.words(start + 0.5 * period, 262, "the force before", colour=GREEN)
    drawing.circle(start + 2 * period, 84, 5, fill=BLUE)
    recorded = "response k+2 records it\nas the command that acted"
    drawing.words(start + 2 * period + 10, 114, recorded, anchor="start", colour=BLUE)
    drawing.arrow((start + 30, 312), (start + period, 312), edge=GREY)
    drawing.arrow((start + period - 30, 312), (start, 312), edge=GREY)
    drawing.words(start + period / 2, 300, "2 ms at 500 Hz", colour=GREY)
    late = "later than 0.8 of the period:\nacts one sample later, counted as late"
    drawing.words(start + 1.06 * period, 306, late, anchor="start", colour=RED)
    return drawing


def states() -> Drawing:
    """The states of a rig and the events between them."""
    drawing = Drawing(760, 420)
    place = {
        "unconfigured": (20, 60, WHITE), "standby": (170, 60, WHITE), "arming": (320, 60, SAND),
        "fading in": (470, 60, MINT), "running": (620, 60, MINT), "ramping down": (545, 190, SAND),
        "latched": (170, 310, ROSE), "protective stop": (360, 310, ROSE), "not at rest": (585, 310, ROSE),
    }  # fmt: skip
    for name, (x, y, fill) in place.items():
        drawing.box(x, y, 118, 44, name, fill=fill)
    for x, words in ((138, "configure"), (288, "activate"), (438, "armed"), (588, "0.5 s")):
        drawing.arrow((x, 82), (x + 32, 82))
        drawing.words(x + 16, 46, words)
    drawing.arrow((529, 104), (585, 188))
    drawing.arrow((679, 104), (625, 188))
    drawing.words(480, 150, "fault, stop,\ndeactivate")
    drawing.arrow((543, 212), (229, 212), (229, 106), edge=INK)
    drawing.words(390, 200, "at rest, deactivated")
    drawing.arrow((570, 234), (290, 322), edge=RED)
    drawing.words(430, 252, "at rest, after a fault", colour=RED)
    drawing.arrow((590, 234), (450, 308), edge=RED)
    drawing.words(556, 286, "stop pressed", colour=RED)
    drawing.arrow((644, 234), (644, 308), edge=RED)
    drawing.words(700, 262, "force or motion\nstill measured", colour=RED)
    drawing.arrow((358, 342), (290, 342))
    drawing.words(324, 368, "stop released")
    drawing.arrow((190, 308), (190, 130), (340, 130), (340, 106), edge=GREEN, width=2)
    drawing.words(120, 200, "a person:\nclear_fault\n(abrace clear,\nClear faults)", colour=GREEN)
    drawing.arrow((600, 356), (600, 396), (229, 396), (229, 356))
    drawing.words(420, 384, "at rest at last")
    drawing.words(20, 24, "Forces act only in the green states. Red: only a person leads on.", anchor="start",
                  colour=GREY)  # fmt: skip
    return drawing


def stops() -> Drawing:
    """Who can stop a rig: three layers, each acting alone."""
    drawing = Drawing(880, 380)
    rows = (
        (
            "abrace\nplant or sensor_bridge",
            "interlock, fault, stop button,\nlost heartbeat of a button",
            "force to zero in 0.5 s, table to rest;\nthen it asks the target for SAFE",
            SAND,
        ),
        (
            "target\nprogram beside the actuators",
            "no command for life_time (at most 0.05 s),\nits own limits, a wrong arm number",
            "its own ramp to zero in 0.1 s,\nthen power off (brake or valve)",
            MINT,
        ),
        (
            "hardware\nno part of abrace",
            "emergency stop pressed by a person;\nlimits of the actuators' controllers",
            "power off at once",
            ROSE,
        ),
    )
    for x, words in ((125, "who"), (410, "what makes it stop"), (725, "what it does")):
        drawing.words(x, 24, words, bold=True)
    for number, (name, why, does, fill) in enumerate(rows):
        y = 44 + 104 * number
        drawing.box(15, y, 220, 76, name, fill=fill)
        drawing.box(255, y, 310, 76, why, fill=WHITE)
        drawing.arrow((565, y + 38), (588, y + 38), edge=RED)
        drawing.box(590, y, 275, 76, does, fill=WHITE, edge=RED)
        if number < 2:
            drawing.arrow((125, y + 76), (125, y + 102), edge=GREY, dashed=True)
            passed = "commands, arm number" if number == 0 else "outputs, power"
            drawing.words(137, y + 90, passed, anchor="start", colour=GREY)
    drawing.words(440, 366, "After each of them a person clears and arms; nothing starts again by itself.", colour=GREY)
    return drawing


def wiring() -> Drawing:
    """A rack: computer, target, amplifiers, actuators, sensors, and the emergency stop in the power line."""
    drawing = Drawing(760, 400)
    drawing.box(20, 40, 150, 70, "computer\nsensor_bridge,\ncontroller, logger", fill=SAND)
    drawing.box(290, 40, 150, 70, "target\nI/O card", fill=MINT)
    drawing.box(560, 40, 170, 70, "amplifiers,\nactuators' controllers")
    drawing.arrow((170, 66), (288, 66), edge=RED)
    drawing.words(229, 54, "commands", colour=RED)
    drawing.arrow((290, 90), (172, 90), edge=BLUE)
    drawing.words(229, 104, "samples", colour=BLUE)
    drawing.words(229, 24, "UDP, a cable of its own", colour=GREY)
    drawing.arrow((440, 66), (558, 66), edge=RED)
    drawing.words(499, 54, "U, w [V]", colour=RED)
    drawing.box(560, 170, 170, 60, "actuators\nand table")
    drawing.arrow((645, 110), (645, 168), edge=RED)
    drawing.box(560, 300, 170, 50, "hydraulic power")
    drawing.arrow((700, 300), (700, 232), width=3)
    drawing.box(360, 296, 150, 58, "EMERGENCY STOP\nwired, no program", fill=ROSE, edge=RED)
    drawing.arrow((510, 325), (558, 325), edge=RED, width=3)
    drawing.arrow((400, 296), (400, 112), edge=RED, dashed=True)
    drawing.words(408, 262, "tells the target", anchor="start", colour=RED)
    drawing.arrow((350, 170), (350, 112), edge=BLUE)
    drawing.box(200, 170, 172, 60, "sensors: x1 x2 x3, xf,\na1 a2 a3, fa fb, w")
    drawing.words(360, 142, "[V]", colour=BLUE, anchor="start")
    drawing.arrow((560, 200), (374, 200), edge=GREY, dashed=True)
    drawing.box(20, 170, 150, 60, "panel with stop\nbutton, page", fill=WHITE)
    drawing.arrow((95, 170), (95, 112), edge=RED, dashed=True)
    drawing.words(104, 142, "/emergency_stop", anchor="start", colour=RED)
    drawing.box(440, 126, 108, 34, "watchdog", fill=WHITE, edge=RED)
    drawing.arrow((420, 112), (452, 124), edge=GREY)
    drawing.arrow((548, 143), (600, 143), (600, 112), edge=RED)
    drawing.words(20, 300, "The stop button is a stop over the\nnetwork: a ramp, then power off.\n"
                  "The emergency stop takes the power.", anchor="start", colour=GREY)  # fmt: skip
    return drawing


def target() -> Drawing:
    """The states of the program beside the actuators."""
    drawing = Drawing(760, 260)
    drawing.box(30, 50, 180, 60, "DISARMED\noutputs zero, no power", fill=WHITE)
    drawing.box(540, 50, 190, 60, "ARMED\npower, follows FOLLOW", fill=MINT)
    drawing.box(180, 184, 180, 60, "STOPPING\npower, its own ramp", fill=SAND)
    drawing.arrow((210, 70), (538, 70), edge=GREEN, width=2)
    drawing.words(375, 56, "HOLD_ZERO with the next arm number", colour=GREEN)
    drawing.arrow((640, 112), (640, 214), (362, 214), edge=RED)
    drawing.words(
        520, 130, "SAFE, no new command,\nanother arm number, not finite,\nmissed ticks, a stop of its own", colour=RED
    )
    drawing.arrow((178, 214), (120, 214), (120, 112))
    drawing.words(180, 148, "outputs zero,\ntable at rest")
    drawing.words(380, 24, "A value never arms, nor does FOLLOW, nor an old number.", colour=GREY)
    return drawing


def computers() -> Drawing:
    """What runs where on two computers."""
    drawing = Drawing(760, 250)
    drawing.box(20, 40, 330, 180, "", fill=WHITE)
    drawing.words(185, 60, "laboratory computer, real time", bold=True)
    drawing.box(40, 80, 140, 40, "sensor_bridge", fill=SAND)
    drawing.box(190, 80, 140, 40, "controller")
    drawing.box(40, 130, 140, 40, "ground_motion")
    drawing.box(190, 130, 140, 40, "logger")
    drawing.words(185, 194, "the loop does not use the network", colour=GREY)
    drawing.box(480, 40, 260, 180, "", fill=WHITE)
    drawing.words(610, 60, "operators' computer", bold=True)
    drawing.box(500, 80, 220, 40, "page in the browser")
    drawing.box(500, 130, 220, 40, "abrace status, Foxglove")
    drawing.words(610, 194, "stop button with heartbeat", colour=RED)
    drawing.arrow((350, 100), (478, 100), edge=BLUE)
    drawing.words(415, 88, "response", colour=BLUE)
    drawing.arrow((480, 150), (352, 150), edge=RED)
    drawing.words(415, 138, "stop, buttons", colour=RED)
    drawing.words(415, 182, "one cable\nor switch,\nno wireless", colour=GREY)
    return drawing


def device() -> Drawing:
    """When the methods of a card of one's own are called."""
    drawing = Drawing(760, 190)
    steps = ("connect()", "write(outputs)", "read()", "disconnect()")
    notes = (
        "activate: outputs\nthat stand there\nare ramped to zero",
        "each tick:\nU of each group,\nthen w [V]",
        "each tick: waits,\nthen readings [V]\nand ticks missed",
        "deactivate, the end:\noutputs are at zero\nby then",
    )
    for number, (name, note) in enumerate(zip(steps, notes, strict=True)):
        x = 20 + 190 * number
        drawing.box(x, 50, 140, 40, name, fill=SAND)
        drawing.words(x + 70, 132, note)
        if number < 3:
            drawing.arrow((x + 140, 70), (x + 188, 70))
    drawing.arrow((470, 48), (470, 24), (280, 24), (280, 48), edge=BLUE)
    drawing.words(375, 36, "500 times a second", colour=BLUE)
    return drawing


def identification() -> Drawing:
    """From two tests to a proven controller."""
    drawing = Drawing(760, 220)
    drawing.box(20, 30, 150, 44, "test: noise on\nthe table", fill=SAND)
    drawing.box(20, 130, 150, 44, "test: noise as\ncommand", fill=SAND)
    drawing.box(230, 80, 120, 44, "identify")
    drawing.arrow((170, 52), (228, 96))
    drawing.arrow((170, 152), (228, 108))
    drawing.box(410, 20, 130, 44, "reduced.json\n8 states", fill=WHITE)
    drawing.box(410, 80, 130, 44, "model.json\n14 states", fill=WHITE)
    drawing.box(410, 140, 130, 44, "validity.svg\nread it first", fill=ROSE)
    for y in (42, 102, 162):
        drawing.arrow((350, 102), (408, y))
    drawing.box(600, 20, 140, 44, "design:\ncontroller, margins")
    drawing.box(600, 130, 140, 44, "validate with\nanother test")
    drawing.arrow((540, 42), (598, 42))
    drawing.arrow((540, 96), (598, 56), dashed=True)
    drawing.arrow((540, 108), (598, 146))
    drawing.words(380, 206, "Design with 8 states, predict with 14.", colour=GREY)
    return drawing


def terminal(title: str, shown: str, red: str = "\0") -> Drawing:
    """A terminal: its command and what it prints."""
    lines = [f"$ {title}", *shown.rstrip().splitlines()]
    drawing = Drawing(round(8.5 * max(map(len, lines))) + 48, round(19 * len(lines)) + 46)
    drawing.box(4, 4, drawing.width - 8, drawing.height - 8, fill="#fbfbf8")
    drawing.screen(24, 34, lines, red)
    return drawing


def block(page: str, begins: str) -> str:
    """The lines of a page's indented or fenced block from the one that begins so, without the indentation."""
    lines = (DOCS / page).read_text(encoding="utf-8").splitlines()
    first = next(number for number, line in enumerate(lines) if line.strip().startswith(begins))
    indent = len(lines[first]) - len(lines[first].lstrip())
    inside = list(takewhile(lambda line: line.strip() and not line.startswith("```"), lines[first:]))
    return "\n".join(line[indent:] for line in inside)


def demo_end() -> Drawing:
    """The last lines of `abrace demo`, as README shows them."""
    return terminal("abrace demo", block("../README.md", "Without and with lqg3"))


def status_after_stop() -> Drawing:
    """`abrace status` after a stop, as the first hour shows it."""
    return terminal("abrace status", block("first_hour.md", "node  "), red="fault")


def foxglove() -> Drawing:
    """The layout for Foxglove, as the program divides its window."""
    content = json.loads(foxglove_layout(3, [2], "/rig/response", "/rig/robot_description"))
    drawing = Drawing(860, 500)

    def place(node: str | dict[str, Any], x: float, y: float, width: float, height: float) -> None:
        if isinstance(node, str):
            panel, (kind, _, subject) = content["configById"][node], node.partition("!")
            names = ", ".join(path["label"] for path in panel.get("paths", []))
            words = "\n".join(filter(None, (panel.get("title") or f"{kind}: {subject}", names)))
            drawing.box(x + 4, y + 4, width - 8, height - 8, words)
            return
        across, share = node["direction"] == "row", node.get("splitPercentage", 50) / 100
        first = (width * share, height) if across else (width, height * share)
        place(node["first"], x, y, *first)
        rest = (x + first[0], y) if across else (x, y + first[1])
        place(node["second"], *rest, x + width - rest[0], y + height - rest[1])

    place(content["layout"], 0, 0, drawing.width, drawing.height)
    return drawing


DRAWINGS = {each.__name__: each for each in (rig, graph, sample, states, stops, wiring, target, computers, device,
                                             identification, demo_end, status_after_stop, foxglove)}  # fmt: skip
OF_EXAMPLES = {"8_hardware": wiring}
"""Pictures of examples."""


def main() -> None:
    """Write every drawing."""
    for name, draw in DRAWINGS.items():
        (FIGURES / f"{name}.svg").write_text(draw().text(), encoding="utf-8")
    for name, draw in OF_EXAMPLES.items():
        (DOCS.parent / "examples" / name / "picture.svg").write_text(draw().text(), encoding="utf-8")


if __name__ == "__main__":
    main()
