# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium, controlled by its DevTools protocol, with the page of a viewer."""

import base64
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from patience import PATIENCE
from PIL import Image
from websockets.sync.client import connect

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-quic", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    # Software rendering: slow, but the same on every machine.
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    # On a busy machine software rendering would be taken for a graphics card that hangs.
    "--disable-gpu-watchdog",
    "--remote-debugging-port=0", "--remote-debugging-address=127.0.0.1",
)
_SLOW_SCREEN = """
const draw = window.requestAnimationFrame.bind(window);
let waiting = new Map(), current = new Map(), number = 0;
window.drawn = 0;
const frame = (time) => {
  current = waiting; waiting = new Map(); window.drawn++;
  for (const [id, f] of current) {
    try { if (current.has(id)) f(time); } catch (error) { reportError(error); }
  }
};
window.requestAnimationFrame = (f) => {
  if (!waiting.size) setTimeout(() => draw(frame), 150);
  waiting.set(++number, f);
  return number;
};
window.cancelAnimationFrame = (id) => { waiting.delete(id); current.delete(id); };
document.addEventListener('DOMContentLoaded', () => {
  const style = document.createElement('style');
  style.textContent = '[class*="Notification"] { display: none }';
  document.head.append(style);
});
"""
"""Limit of six frames a second, as software rendering would use the processor time of the nodes
under test. The page's notification about its low frame rate, which covers the scene, is hidden."""


def find_browser() -> str | None:
    """Return the path of a browser, None where none is installed."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


class Browser:
    """Browser with one page; it ends with the context."""

    def __init__(
        self, executable: str, folder: Path, size: tuple[int, int] = (800, 400)
    ) -> None:
        self._folder = folder
        self._size = size
        self.console: list[str] = []
        """Errors that the page has logged."""
        self.requested: list[str] = []
        """Addresses that the page has requested."""
        self.meanwhile: Callable[[], object] = lambda: None
        """What is called while it waits, as the `tick` of a viewer in this process."""
        self._number = 0
        self._session: str | None = None
        self._drawn: bytes | None = None
        command = [executable, *_FLAGS, f"--window-size={size[0]},{size[1]}",
                   f"--user-data-dir={folder}", "about:blank"]
        self._log = (folder / "browser.log").open("wb")
        self._socket: Any = None
        # Short, as the path of a socket in it is limited, and removed with the browser.
        self._temporary = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            command, stdout=self._log, stderr=self._log,
            env={**os.environ, "TMPDIR": self._temporary.name},
            # As for a user: the scheduler divides processor time between sessions first.
            start_new_session=True,
        )

    def __enter__(self) -> "Browser":
        try:
            # Without pings, which a browser on a busy machine does not answer in time.
            self._socket = connect(
                self._address(), max_size=None, compression=None, ping_interval=None
            )
            # The first target of a browser that starts may not be a page yet.
            target = self.call("Target.createTarget", url="about:blank")["targetId"]
            attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        except BaseException:
            self.__exit__()
            raise
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=_SLOW_SCREEN)
        self.resize(*self._size)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._socket is not None:
            self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._log.close()
        self._temporary.cleanup()

    def call(self, method: str, **parameters: Any) -> Any:
        """Return the answer to a command; events that arrive before it are stored."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._store(answer.get("method", ""), answer.get("params", {}))

    def resize(self, width: int, height: int) -> None:
        """Set the size of the page [px]; a narrow one is that of a phone."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1.0, mobile=width < 500)

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def reset(self) -> None:
        """Leave the page, and forget what it has logged and requested."""
        self.meanwhile = lambda: None
        self.open("about:blank")
        self.resize(*self._size)
        self.console.clear()
        self.requested.clear()

    def evaluate(self, script: str) -> Any:
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return result["result"].get("value")

    @property
    def text(self) -> str:
        """Visible text of the page."""
        return str(self.evaluate("document.body ? document.body.innerText : ''"))

    def wait_for(self, words: str) -> None:
        self.wait(lambda: words in self.text, f"no '{words}' on the page")

    def wait(self, condition: Callable[[], object], fault: str = "time-out") -> None:
        """Wait until a condition holds."""
        end = time.monotonic() + PATIENCE
        while self.meanwhile() or not condition():
            assert time.monotonic() < end, f"{fault}:\n{self.text}\n{self.console}"
            time.sleep(0.05)

    def settle(self) -> None:
        """Wait until the page has drawn some frames, after the compilation of its shaders."""
        before = self.evaluate("window.drawn")
        self.wait(lambda: self.evaluate("window.drawn") >= before + 5, "the page does not draw")

    def click_button(self, label: str) -> None:
        self._click("button", f"e.innerText.trim() === {json.dumps(label)}")

    def type_number(self, label: str, number: str) -> None:
        """Replace the number in the field beside a label."""
        self._click("input.mantine-NumberInput-input", _beside(label))
        self.evaluate("document.activeElement.select()")
        self.call("Input.insertText", text=number)
        # The page sends the newest change of all fields, at most every 50 ms by its own timer.
        self.evaluate("window.sent = false; setTimeout(() => { window.sent = true; }, 200)")
        self.wait(lambda: self.evaluate("window.sent"), "the page's timers do not run")

    def check(self, label: str) -> None:
        self._click("input[type=checkbox]", _beside(label))

    def box(self, selector: str) -> tuple[float, float, float, float]:
        """Return left, top, width and height of the largest element of a selector [px]."""
        script = (
            f"[...document.querySelectorAll({json.dumps(selector)})]"
            ".map(e => e.getBoundingClientRect()).map(r => [r.x, r.y, r.width, r.height])"
            ".sort((a, b) => b[2] * b[3] - a[2] * a[3])[0]"
        )
        return tuple(self.evaluate(script))

    def _click(self, selector: str, condition: str) -> None:
        """Wait for a visible element that satisfies a condition, and click it.

        The element gets the events of a click in the script that finds it: mouse coordinates
        would be outdated where a slow page moves its elements.
        """
        script = (
            f"(() => {{ const e = [...document.querySelectorAll({json.dumps(selector)})]"
            f".find(e => e.getBoundingClientRect().width > 0 && ({condition}));"
            " if (!e) return false; e.scrollIntoView({block: 'center'}); e.focus();"
            " e.click(); return true; })()"
        )
        self.wait(lambda: self.evaluate(script), f"no {selector} with {condition}")

    def click(self, place: tuple[float, float]) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self._mouse(kind, *place)
            time.sleep(0.1)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 5) -> None:
        """Drag with the mouse from one pixel to another."""
        self._mouse("mouseMoved", *start)
        time.sleep(0.3)
        self._mouse("mousePressed", *start)
        time.sleep(0.2)
        for x, y in np.linspace(start, end, steps + 1)[1:].tolist():
            self._mouse("mouseMoved", x, y, held=True)
            time.sleep(0.04)
        time.sleep(0.3)
        self._mouse("mouseReleased", *end)

    def picture(self) -> np.ndarray:
        """Return the pixels of the next drawn frame, shape (height, width, 3).

        On a busy machine a snapshot may never be taken.
        """
        self._drawn = None
        self.call("Page.startScreencast", format="png")
        self.wait(lambda: self.evaluate("0") or self._drawn is not None, "no frame was drawn")
        self.call("Page.stopScreencast")
        return np.asarray(Image.open(io.BytesIO(self._drawn)).convert("RGB"), dtype=float)

    def _mouse(self, kind: str, x: float, y: float, held: bool = False) -> None:
        button = "left" if kind != "mouseMoved" or held else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button,
                  buttons=int(held or kind == "mousePressed"),
                  clickCount=int(kind != "mouseMoved"))

    def _address(self) -> str:
        """Return the DevTools address of the browser, which it writes to a file."""
        file, end = self._folder / "DevToolsActivePort", time.monotonic() + PATIENCE
        while not (file.exists() and file.read_text().count("\n")):
            assert time.monotonic() < end and self._process.poll() is None, "no browser"
            time.sleep(0.05)
        port, path = file.read_text().splitlines()[:2]
        return f"ws://127.0.0.1:{port}{path}"

    def _store(self, method: str, event: dict[str, Any]) -> None:
        level = event.get("entry", {}).get("level", event.get("type"))
        if method == "Runtime.exceptionThrown" or level in ("error", "assert"):
            self.console.append(str(event))
        elif method == "Page.screencastFrame":
            self._drawn = base64.b64decode(event["data"])
        elif method == "Network.requestWillBeSent":
            self.requested.append(event["request"]["url"])


def _beside(label: str) -> str:
    """Return the condition that a label is the text beside an element."""
    return (
        "(() => { let n = e; while (n && !n.innerText.trim()) n = n.parentElement;"
        f" return n && n.innerText.trim() === {json.dumps(label)}; }})()"
    )


def pixel(page: Browser, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return the pixel of a point [m; world frame] in the initial view."""
    from sphere_sim.viewer.scene import CAMERA, LOOK_AT  # where viser is installed

    left, top, width, height = page.box("canvas")
    ahead = np.subtract(LOOK_AT, CAMERA)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    down = np.cross(ahead, right)
    axes = [axis / np.linalg.norm(axis) for axis in (right, down, ahead)]
    x, y, depth = (axes @ np.subtract(point, CAMERA)).tolist()
    scale = 0.5 * height / np.tan(np.radians(45.0) / 2.0) / depth
    return left + 0.5 * width + scale * x, top + 0.5 * height + scale * y


def colour(page: Browser, point: tuple[float, float, float]) -> np.ndarray:
    """Return the colour of the pixel of a point [m; world frame] in the initial view."""
    x, y = map(int, pixel(page, point))
    return page.picture()[y, x]


def scene_of(page: Browser) -> np.ndarray:
    """Return the pixels of the scene once it is drawn, shape (height, width, 3)."""

    def scene() -> np.ndarray:
        left, top, width, height = map(int, page.box("canvas"))
        return page.picture()[top : top + height, left : left + width]

    page.wait(lambda: np.std(scene()) > 5.0, "the scene is empty")
    return scene()
