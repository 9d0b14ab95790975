"""A headless Chromium with software rendering, controlled through its debugging pipe."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

DRAWING = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # Optimising the viewer's machine code takes more than it brings in half a minute.
    "--js-flags=--liftoff-only",
)
"""For WebGL without a graphics card."""
FLAT = ("--no-sandbox", "--disable-gpu")
"""For pages without WebGL: a third less processor time than with an emulated graphics card."""
FLAGS = (
    "--headless=new",
    *DRAWING,
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--hide-scrollbars",
    "--mute-audio",
    "--remote-debugging-pipe",
)


def program() -> str | None:
    """Where Chromium is, if anywhere."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)


class Chromium:
    """One browser with one page, on fresh settings that are deleted with it."""

    def __init__(self, width: int = 1600, height: int = 1000) -> None:
        self._profile = tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True)
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        command = [program() or "chromium", *FLAGS]
        command += [f"--user-data-dir={self._profile.name}", f"--window-size={width},{height}"]
        # Chromium reads its orders from descriptor 3 and answers on 4; the shell puts ours there.
        shell = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "chromium", *command, "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(theirs_in, theirs_out),
            start_new_session=True,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._in, self._out, self._left = ours_in, ours_out, b""
        self._count = 0
        self.requests: list[str] = []
        """Addresses the page asked for."""
        self.console: list[str] = []
        """What the page wrote to its console as a warning or an error."""
        page = next(
            target
            for target in self._ask("Target.getTargets")["targetInfos"]
            if target["type"] == "page"
        )
        self._session = None
        attached = self._ask("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime"):
            self._ask(f"{domain}.enable")
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._profile.cleanup()

    def open(self, url: str) -> None:
        """Go to an address."""
        self._ask("Page.navigate", url=url)

    def picture(self) -> np.ndarray:
        """Return what the page shows now, RGB uint8, (height, width, 3)."""
        shot = None
        while shot is None:
            try:
                shot = self._ask("Page.captureScreenshot", format="png")
            except RuntimeError as error:
                # Between two pages there is nothing to take a picture of.
                if "active page" not in str(error):
                    raise
                time.sleep(0.2)
        encoded = np.frombuffer(base64.b64decode(shot["data"]), np.uint8)
        return cv2.imdecode(encoded, cv2.IMREAD_COLOR)[..., ::-1]

    def evaluate(self, expression: str):
        """Return the value of a JavaScript expression."""
        answer = self._ask("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    def press(self, key: str, code: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self._ask("Input.dispatchKeyEvent", type=kind, key=key, code=code)

    def click(self, x: float, y: float) -> None:
        """Click at a point of the page."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def _ask(self, method: str, **params: object) -> dict:
        self._count += 1
        order = {"id": self._count, "method": method, "params": params}
        if getattr(self, "_session", None):
            order["sessionId"] = self._session
        os.write(self._out, json.dumps(order).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self._note(message)

    def _note(self, message: dict) -> None:
        params = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif message.get("method") == "Runtime.consoleAPICalled":
            if params["type"] in ("error", "warning"):
                words = (str(arg.get("value", "")) for arg in params["args"])
                self.console.append(" ".join(words))
        elif message.get("method") == "Runtime.exceptionThrown":
            self.console.append(json.dumps(params["exceptionDetails"])[:500])

    def _next(self, limit_s: float = 60.0) -> dict:
        deadline = time.monotonic() + limit_s
        while b"\0" not in self._left:
            ready, _, _ = select.select([self._in], [], [], max(0.0, deadline - time.monotonic()))
            part = os.read(self._in, 1 << 20) if ready else b""
            if not part:
                raise TimeoutError("Chromium does not answer")
            self._left += part
        message, self._left = self._left.split(b"\0", 1)
        return json.loads(message)


def save(picture: np.ndarray, path: Path | str) -> None:
    """Write a picture as PNG."""
    cv2.imwrite(str(path), picture[..., ::-1])
