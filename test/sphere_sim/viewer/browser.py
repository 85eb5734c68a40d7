# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, spoken to in its own protocol over the websocket library of viser."""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

PATIENCE = 180.0
"""How long a page that is drawn without a graphics card may take on a busy machine [s]."""
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-quic", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    # Without a graphics card; slow, but the same pixels everywhere.
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    # A busy machine is not a graphics card that hangs.
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
"""At most six frames a second, and what is asked for meanwhile is drawn with them: drawn without a
graphics card, a page would take the processor from the nodes under test. It says so in a notice
before the scene, which is hidden."""


def find_browser() -> str | None:
    """Return the path of a browser, None where none is installed."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


class Browser:
    """One page in a browser of its own; ends with the context."""

    def __init__(self, executable: str, folder: Path, size: tuple[int, int] = (800, 400),
                 sharpness: float = 1.0) -> None:
        self._folder = folder
        self.size = size
        self._sharpness = sharpness
        self.console: list[str] = []
        """Errors and warnings of the page, as it logs them."""
        self.requested: list[str] = []
        """Addresses the page has asked for."""
        self._number = 0
        command = [executable, *_FLAGS, f"--window-size={size[0]},{size[1]}",
                   f"--user-data-dir={folder}", "about:blank"]
        self._log = (folder / "browser.log").open("wb")
        self._socket: Any = None
        # What it leaves behind there goes with this; a long path would be too long for its socket.
        self._left_behind = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            command, stdout=self._log, stderr=self._log,
            env={**os.environ, "TMPDIR": self._left_behind.name},
            # As with people: the scheduler shares processors out between sessions first.
            start_new_session=True,
        )

    def __enter__(self) -> "Browser":
        try:
            self._attach()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _attach(self) -> None:
        self._socket = connect(self._address(), max_size=None, compression=None)
        # A page of its own: the first target of a browser that comes up need not be one yet.
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=_SLOW_SCREEN)
        width, height = self.size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=self._sharpness, mobile=False)

    def __exit__(self, *exception: object) -> None:
        if self._socket is not None:
            self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._log.close()
        self._left_behind.cleanup()

    _session: str | None = None
    _drawn: bytes | None = None

    def call(self, method: str, **parameters: Any) -> Any:
        """Return the answer of the browser; what happens meanwhile is noted."""
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
            self._note(answer.get("method", ""), answer.get("params", {}))

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def evaluate(self, script: str) -> Any:
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return result["result"].get("value")

    @property
    def text(self) -> str:
        """What there is to read on the page."""
        return str(self.evaluate("document.body ? document.body.innerText : ''"))

    def wait_for(self, words: str) -> None:
        """Wait until the page has some words."""
        end = time.monotonic() + PATIENCE
        while words not in self.text:
            assert time.monotonic() < end, (
                f"no '{words}' on the page after {PATIENCE} s:\n{self.text}\n{self.console}"
            )
            time.sleep(0.05)

    def settle(self, patience: float = PATIENCE) -> None:
        """Wait until the page draws steadily: first its shaders are compiled, for some seconds."""
        end = time.monotonic() + patience
        while True:
            before = self.evaluate("window.drawn")
            time.sleep(1.5)
            if self.evaluate("window.drawn") >= before + 5:
                return
            assert time.monotonic() < end, "the page does not draw"

    def click_button(self, label: str) -> None:
        """Click the button with this label, with the mouse."""
        self._click("button", f"e.innerText.trim() === {json.dumps(label)}")

    def choose(self, shown: str, option: str) -> None:
        """Open the list that shows one thing and take another from it."""
        self._click("input[role=combobox]", f"e.value === {json.dumps(shown)}")
        # It unfolds.
        self._click("[role=option]", f"e.innerText.trim() === {json.dumps(option)}")

    def type_number(self, label: str, number: str) -> None:
        """Put a number in place of the one in the field beside a label."""
        beside = (
            "(() => { let n = e; while (n && !n.innerText.trim()) n = n.parentElement;"
            f" return n && n.innerText.trim() === {json.dumps(label)}; }})()"
        )
        self._click("input.mantine-NumberInput-input", beside)
        self.evaluate("document.activeElement.select()")
        self.call("Input.insertText", text=number)

    def boxes(self, selector: str) -> list[tuple[float, float, float, float]]:
        """Return left, top, width and height of what is seen of a kind of elements [px]."""
        script = (
            f"[...document.querySelectorAll({json.dumps(selector)})]"
            ".map(e => e.getBoundingClientRect()).filter(r => r.width > 0)"
            ".map(r => [r.x, r.y, r.width, r.height])"
        )
        return [tuple(box) for box in self.evaluate(script)]

    def _click(self, selector: str, condition: str, patience: float = 30.0) -> None:
        script = (
            f"(() => {{ const e = [...document.querySelectorAll({json.dumps(selector)})]"
            f".find(e => e.getBoundingClientRect().width > 0 && ({condition}));"
            " if (!e) return null; e.scrollIntoView({block: 'center'});"
            " const r = e.getBoundingClientRect();"
            " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        end, place = time.monotonic() + patience, None
        # What still moves, as lists that unfold do, would be missed.
        while place is None or self.evaluate(script) != place:
            assert time.monotonic() < end, f"no {selector} with {condition}"
            place = self.evaluate(script)
            time.sleep(0.1)
        self._mouse("mouseMoved", *place)
        self._mouse("mousePressed", *place)
        self._mouse("mouseReleased", *place)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 5) -> None:
        """Drag with the mouse from one pixel to another."""
        self._mouse("mouseMoved", *start)
        time.sleep(0.3)
        self._mouse("mousePressed", *start)
        time.sleep(0.2)
        for i in range(1, steps + 1):
            share = i / steps
            self._mouse("mouseMoved", start[0] + share * (end[0] - start[0]),
                        start[1] + share * (end[1] - start[1]), held=True)
            time.sleep(0.04)
        time.sleep(0.3)
        self._mouse("mouseReleased", *end)

    def screenshot(self, path: Path) -> bytes:
        """Save what is seen; from the stream of drawn frames, as a snapshot may never come."""
        self._drawn = None
        self.call("Page.startScreencast", format="png")
        end = time.monotonic() + PATIENCE
        while self._drawn is None:
            assert time.monotonic() < end, "no frame was drawn"
            self.evaluate("0")
            time.sleep(0.05)
        self.call("Page.stopScreencast")
        path.write_bytes(self._drawn)
        return self._drawn

    def _mouse(self, kind: str, x: float, y: float, held: bool = False) -> None:
        button = "left" if kind != "mouseMoved" or held else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button,
                  buttons=int(held or kind == "mousePressed"),
                  clickCount=int(kind != "mouseMoved"))

    def _address(self) -> str:
        """Return where the browser listens, which it writes to a file."""
        file, end = self._folder / "DevToolsActivePort", time.monotonic() + PATIENCE
        while not (file.exists() and file.read_text().count("\n")):
            assert time.monotonic() < end and self._process.poll() is None, "no browser came up"
            time.sleep(0.05)
        port, path = file.read_text().splitlines()[:2]
        return f"ws://127.0.0.1:{port}{path}"

    def _note(self, method: str, told: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.console.append(" ".join(str(a.get("value", a)) for a in told["args"]))
        elif method == "Runtime.exceptionThrown":
            self.console.append(told["exceptionDetails"]["text"])
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.console.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif method == "Page.screencastFrame":
            self._drawn = base64.b64decode(told["data"])
        elif method == "Network.requestWillBeSent":
            self.requested.append(told["request"]["url"])
