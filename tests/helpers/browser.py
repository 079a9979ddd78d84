"""Headless Chromium, controlled through a pipe by the DevTools protocol, without other tools."""

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--hide-scrollbars",
    "--no-first-run",
    "--remote-debugging-pipe",
)


def installed() -> str | None:
    """Return the path of an installed browser, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of a browser."""

    def __init__(self, given: Any, said: Any):
        self._given = given
        self._said = said
        self._number = 0
        self._session = {}
        # Messages of the console and of the security policy.
        self.remarks: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = {
            "sessionId": self.call("Target.attachToTarget", targetId=target, flatten=True)[
                "sessionId"
            ]
        }
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its answer."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters} | self._session
        self._given.write(json.dumps(message).encode() + b"\0")
        self._given.flush()
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]

    def _read(self) -> dict[str, Any]:
        letters = bytearray()
        while (letter := self._said.read(1)) != b"\0":
            assert letter, "the browser has ended"
            letters += letter
        answer = json.loads(letters)
        if answer.get("method") in (
            "Runtime.exceptionThrown",
            "Runtime.consoleAPICalled",
            "Log.entryAdded",
        ):
            self.remarks.append(answer["params"])
        return answer

    def open(self, path: Path, width: int, height: int, scheme: str = "light") -> None:
        """Open a file in a window of this size, with a light or a dark colour scheme."""
        self.remarks.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2,
            mobile=width < 500,
        )
        self.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": scheme}],
        )
        self.call("Page.navigate", url=path.as_uri())
        while self.run("document.readyState") != "complete":
            pass

    def run(self, script: str, frame: str = "") -> Any:
        """Return the value of an expression in the page, after waiting for a promise.

        With `frame` in the frame whose address has this in it.
        """
        context = {"contextId": self._context(frame)} if frame else {}
        answer = self.call(
            "Runtime.evaluate",
            expression=script,
            returnByValue=True,
            awaitPromise=True,
            **context,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def _context(self, address: str) -> int:
        """Return an isolated script context in a frame, without access to its variables."""
        frames = self.call("Page.getFrameTree")["frameTree"].get("childFrames", [])
        (number,) = (
            each["frame"]["id"] for each in frames if address in each["frame"].get("url", "")
        )
        return int(self.call("Page.createIsolatedWorld", frameId=number)["executionContextId"])

    def wait_for(self, script: str, patience: float = 60.0, frame: str = "") -> None:
        """Wait until an expression is true in the page, or in one of its frames."""
        end = time.monotonic() + patience
        while not self.run(script, frame):
            assert time.monotonic() < end, script
            time.sleep(0.05)

    def press(self, key: str, text: str = "") -> None:
        """Press and release a key."""
        name = {"key": key, "code": {" ": "Space"}.get(key, key)}
        code = {
            "Tab": 9,
            " ": 32,
            "ArrowLeft": 37,
            "ArrowUp": 38,
            "ArrowRight": 39,
            "ArrowDown": 40,
        }.get(key, 0)
        self.call(
            "Input.dispatchKeyEvent", type="keyDown", windowsVirtualKeyCode=code, text=text, **name
        )
        self.call("Input.dispatchKeyEvent", type="keyUp", windowsVirtualKeyCode=code, **name)

    def point(self, x: float, y: float) -> None:
        """Move the pointer."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def click(self, x: float, y: float) -> None:
        """Press and release the mouse button at a place."""
        button = {"x": x, "y": y, "button": "left", "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", **button)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", **button)

    def screenshot(self, path: Path) -> None:
        """Save a picture of the whole page."""
        taken = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(taken["data"]))


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """Start a browser with its files in a folder, and end it at exit."""
    ours, theirs = os.pipe(), os.pipe()  # The browser reads from 3 and writes to 4.
    given = os.fdopen(ours[1], "wb")
    said = os.fdopen(theirs[0], "rb")
    script = f'exec "$0" "$@" 3<&{ours[0]} 4>&{theirs[1]}'
    arguments = [installed() or "", *FLAGS, f"--user-data-dir={folder}"]
    process = subprocess.Popen(
        ["bash", "-c", script, *arguments],
        pass_fds=(ours[0], theirs[1]),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(ours[0])
    os.close(theirs[1])
    try:
        yield Browser(given, said)
    finally:
        process.kill()
        process.wait()
        given.close()
        said.close()
