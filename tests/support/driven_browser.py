# SPDX-License-Identifier: Apache-2.0
"""Drives headless Chromium by its DevTools protocol: opens pages, clicks, types, and evaluates expressions."""

from __future__ import annotations

import asyncio
import base64
import itertools
import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from browser import CHROMIUM
from tornado.websocket import WebSocketClientConnection, websocket_connect

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from types import TracebackType
    from typing import Self

PATIENCE = 60.0
LARGEST = 2**26
KEYS = {"Escape": (27, ""), " ": (32, " "), "Enter": (13, "\r"), "Tab": (9, "")}
"""Code and text of keys that are no letter or digit."""


class DrivenBrowser:
    """A browser; a context manager.

    Parameters
    ----------
    options
        Further command line options.
    """

    def __init__(self, *options: str) -> None:
        assert CHROMIUM is not None, "no Chromium on this machine"
        self._options = options
        self._loop = asyncio.new_event_loop()
        self._numbers = itertools.count(1)
        self._answers: dict[int, dict[str, Any]] = {}
        self.tabs: dict[str, Tab] = {}

    def _await(self, begin: Callable[[], Awaitable[Any]]) -> Any:
        async def wait() -> Any:
            return await asyncio.wait_for(begin(), PATIENCE)

        return self._loop.run_until_complete(wait())

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self._end()
            raise
        return self

    def _start(self) -> None:
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"]
        command += ["--remote-debugging-port=0", f"--user-data-dir={self._profile.name}", "--window-size=1280,1000"]
        quiet = subprocess.DEVNULL
        self.process = subprocess.Popen([*command, *self._options, "about:blank"], stdout=quiet, stderr=quiet)
        told = Path(self._profile.name) / "DevToolsActivePort"
        deadline = time.monotonic() + PATIENCE
        while not told.is_file() or len(told.read_text().split()) < 2:
            assert time.monotonic() < deadline, "the browser does not start"
            time.sleep(0.02)
        port, path = told.read_text().split()
        self._socket: WebSocketClientConnection = self._await(
            lambda: websocket_connect(f"ws://127.0.0.1:{port}{path}", max_message_size=LARGEST)
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.run_until_complete(self._close())
        self._end()

    async def _close(self) -> None:
        self._socket.close()

    def _end(self) -> None:
        self.process.terminate()
        self.process.wait()
        self._loop.close()
        self._profile.cleanup()

    def open(self, url: str) -> Tab:
        """Open a page in a new tab."""
        target = self.command("Target.createTarget", url="about:blank")["targetId"]
        session = self.command("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = self.tabs[session] = Tab(self, session, target)
        for domain in ("Runtime", "Page", "Log"):
            tab.command(f"{domain}.enable")
        tab.command("Page.navigate", url=url)
        return tab

    def frames(self) -> list[str]:
        """The addresses of the pages in frames of other sites; an error page's if the site refuses to be framed."""
        targets = self.command("Target.getTargets")["targetInfos"]
        found = []
        for target in (one["targetId"] for one in targets if one["type"] == "iframe"):
            session = self.command("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            answer = self.command("Runtime.evaluate", session, expression="location.href", returnByValue=True)
            found.append(str(answer["result"]["value"]))
        return found

    def send(self, method: str, session: str = "", **parameters: Any) -> int:
        """Send a command and do not wait; returns its number."""
        number = next(self._numbers)
        content = {"id": number, "method": method, "params": parameters}
        if session:
            content["sessionId"] = session
        self._await(lambda: self._socket.write_message(json.dumps(content)))
        return number

    def command(self, method: str, session: str = "", **parameters: Any) -> dict[str, Any]:
        """Send a command; returns its result."""
        number = self.send(method, session, **parameters)
        while number not in self._answers:
            self._receive()
        answer = self._answers.pop(number)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return dict(answer["result"])

    def _receive(self) -> None:
        message = self._await(lambda: self._socket.read_message())
        assert message is not None, "the browser has ended"
        content = json.loads(message)
        if "id" in content:
            self._answers[content["id"]] = content
        elif content.get("sessionId") in self.tabs:
            self.tabs[content["sessionId"]].note(content["method"], content["params"])


class Tab:
    """A page in a `browser`, by its `session` and `target`."""

    def __init__(self, browser: DrivenBrowser, session: str, target: str) -> None:
        self._browser, self._session, self._target = browser, session, target
        self.errors: list[str] = []
        """Errors in its console, and requests that the browser refused."""

    def note(self, method: str, parameters: dict[str, Any]) -> None:
        """An event of its own."""
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(parameters["exceptionDetails"].get("exception", {}).get("description")))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(str(parameters["entry"]["text"]))

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the protocol."""
        return self._browser.command(method, self._session, **parameters)

    def evaluate(self, expression: str) -> Any:
        """The value of an expression of JavaScript, awaited."""
        answer = self.command("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, expression: str) -> Any:
        """Wait until an expression is true; returns its value."""
        deadline = time.monotonic() + PATIENCE
        while not (value := self.evaluate(expression)):
            assert time.monotonic() < deadline, f"waited for {expression}; the page: {self.text()[:2000]}"
            time.sleep(0.02)
        return value

    def text(self, selector: str = "body") -> str:
        """The text that an element shows."""
        return str(self.evaluate(f"document.querySelector({json.dumps(selector)}).innerText"))

    def until_shown(self, selector: str, words: str) -> None:
        """Wait until an element shows these words."""
        element = f"document.querySelector({json.dumps(selector)})"
        self.until(f"{element} !== null && {element}.innerText.includes({json.dumps(words)})")

    def middle(self, selector: str) -> tuple[float, float]:
        """The centre of an element, which is scrolled into view."""
        element = f"document.querySelector({json.dumps(selector)})"
        box = self.evaluate(
            f"(() => {{ const e = {element}; e.scrollIntoViewIfNeeded(); const b = e.getBoundingClientRect();"
            " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        return float(box[0]), float(box[1])

    def click(self, selector: str) -> None:
        """Click an element with the mouse."""
        x, y = self.middle(selector)
        for event in ("mousePressed", "mouseReleased"):
            self.mouse(event, x, y)

    def mouse(self, event: str, x: float, y: float, wait: bool = True) -> None:
        """Send an `event` of the left mouse button; `wait` until the page has handled it."""
        parameters = {"type": event, "x": x, "y": y, "button": "left", "clickCount": 1}
        act = self._browser.command if wait else self._browser.send
        act("Input.dispatchMouseEvent", self._session, **parameters)

    def press(self, key: str, repeats: int = 0) -> None:
        """Press a letter, a digit, or a key of KEYS; held down it `repeats`."""
        code, text = KEYS[key] if key in KEYS else (ord(key.upper()), key)
        event = {"key": key, "windowsVirtualKeyCode": code}
        for repeat in range(1 + repeats):
            self.command("Input.dispatchKeyEvent", type="keyDown", text=text, autoRepeat=repeat > 0, **event)
        self.command("Input.dispatchKeyEvent", type="keyUp", **event)

    def screenshot(self, path: Path) -> None:
        """A screenshot, as PNG."""
        path.write_bytes(base64.b64decode(self.command("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """Close it."""
        self._browser.command("Target.closeTarget", targetId=self._target)
