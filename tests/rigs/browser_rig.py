"""Studios in processes of their own, and Debian's Chromium that opens them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent.parent

# `atRest()`: whether the page has no call under way and had none a moment ago. Calls take by chance up to `longest`
# milliseconds more there, and back: newer answers may come before older ones.
CALLS = """([seed, longest]) => {
  let state = seed, calls = 0, last = 0;
  const pause = () => new Promise((resolve) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    setTimeout(resolve, Math.max(0, longest * (state / 2 ** 31 - 1)));
  });
  const { fetch } = window;
  window.fetch = async (...words) => {
    calls += 1;
    try {
      if (longest) await pause();
      const answer = await fetch(...words);
      if (longest) await pause();
      return answer;
    } finally {
      calls -= 1;
      last = performance.now();
    }
  };
  globalThis.atRest = () => !calls && performance.now() - last > 200;
}"""
# A seed in the environment slows answers down; the tests must pass with any.
SEED = os.environ.get("GEOMOSAIC_SLOW_ANSWERS", "")


class RunningStudio:
    """A `geomosaic studio` process and the address that it printed."""

    def __init__(self, project: Path, *arguments: str) -> None:
        path = os.pathsep.join([str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")])
        words = [sys.executable, "-m", "geomosaic.cli", "studio", str(project), "--no-browser", "--json", *arguments]
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path}
        )
        assert self.process.stdout is not None
        said = json.loads(self.process.stdout.readline() or "{}")
        self.address: str = said.get("address", "")
        assert self.address, f"{said} {self.process.communicate()[1]}"

    @property
    def port(self) -> int:
        return int(self.address.partition("#")[0].rstrip("/").rpartition(":")[2])

    def kill(self) -> None:
        """End it as a crash would."""
        self.process.kill()
        self.process.communicate()

    def stop(self) -> int:
        """End it as Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=20)
        return self.process.returncode


@contextmanager
def running_studio(project: Path, *arguments: str) -> Iterator[RunningStudio]:
    """Studio that ends with the block."""
    studio = RunningStudio(project, *arguments)
    try:
        yield studio
    finally:
        studio.kill()


def chromium() -> str:
    """Path of the browser; tests are skipped, with the reason, where there is none."""
    pytest.importorskip("playwright", reason="playwright is not installed")
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no chromium: apt-get install chromium")
    return found


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium without a window, driven by playwright."""
    path = chromium()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        # Containers of tests run as root, and have little shared memory.
        opened = driver.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage"])
        try:
            yield opened
        finally:
            opened.close()


class Faults(list[str]):
    """What the scripts of pages complain of; the browser's own words on calls that fail are no complaint."""

    def watch(self, page: Any) -> None:
        page.on("pageerror", lambda error: self.append(str(error)))
        page.on("console", lambda message: self._hear(message.type, message.text))

    def _hear(self, kind: str, text: str) -> None:
        if kind in ("error", "warning") and not text.startswith(("Failed to load resource", "Canvas2D:")):
            self.append(text)


class Pane:
    """One of the two pictures, and where its places lie on the screen once its view rests."""

    def __init__(self, page: Any, name: str) -> None:
        self.page, self.section = page, page.locator(f"#{name}-view")
        self.canvas = self.section.locator(".canvas")

    def click(self, place: np.ndarray) -> None:
        """Click at col and row of the image, or x and y of the map."""
        self.page.mouse.click(*self.screen(place))

    def hover(self, place: np.ndarray) -> None:
        """Point at a place."""
        self.page.mouse.move(*self.screen(place))

    def screen(self, place: np.ndarray) -> np.ndarray:
        """Place on the screen of col and row of the image, or x and y of the map."""
        at = self.canvas.evaluate("(canvas, place) => canvas.view.onScreen(place)", [float(value) for value in place])
        return np.array(at)


def open_page(context: Any, address: str, faults: Faults) -> Any:
    """Page of a studio, once it has read the project."""
    from playwright.sync_api import expect

    page = context.new_page()
    faults.watch(page)
    page.add_init_script(f"({CALLS})({[int(SEED), 500] if SEED else [0, 0]})")
    page.goto(address)
    expect(page.locator("#status")).not_to_have_text("Opening the project …", timeout=15000)
    return page


def rest(page: Any) -> None:
    """Wait until the page has all its answers and has drawn them."""
    page.wait_for_function("() => atRest()", timeout=20_000)
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


@contextmanager
def messages(page: Any, *texts: str) -> Iterator[None]:
    """Block after which the page has said all these texts, in this order, however short each of them stood there."""
    page.evaluate(
        """() => {
            const status = document.querySelector("#status");
            globalThis.messages = [];
            new MutationObserver(() => globalThis.messages.push(status.textContent))
                .observe(status, { childList: true, characterData: true, subtree: true });
        }"""
    )
    yield
    page.wait_for_function(
        """texts => texts.reduce((from, text) => {
            const found = from < 0 ? -1 : globalThis.messages.findIndex((one, at) => at >= from && one.includes(text));
            return found < 0 ? -1 : found + 1;
        }, 0) > 0""",
        arg=[*texts],
        timeout=20_000,
    )


def picture(page: Any, name: str) -> None:
    """Picture of a page for the docs, where GEOMOSAIC_DOCS_PICTURES names the folder."""
    folder = os.environ.get("GEOMOSAIC_DOCS_PICTURES")
    if folder:
        page.wait_for_timeout(700)  # tiles come and zooms end
        page.screenshot(path=str(Path(folder) / name), type="jpeg", quality=85)
