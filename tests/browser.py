"""Opens pages in QtWebEngine (Chromium), as a script of its own, and prints what it finds as JSON.

    python tests/browser.py PAGE.html [PAGE.html ...]

The first line says that the engine works; then there is one line per page. A crash of the
engine ends this process and not the tests'; what is printed says how far it came.

Where PAGE.js lies beside a page it runs on the desk: the value of its last expression, a promise of
text, is printed as JSON, too, and the page printed to PAGE.pdf.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

os.environ["QT_QPA_PLATFORM"] = "offscreen"
os.environ["QTWEBENGINE_DISABLE_SANDBOX"] = "1"
os.environ["QTWEBENGINE_CHROMIUM_FLAGS"] = "--no-sandbox --disable-gpu --disable-dev-shm-usage"

from PySide6.QtCore import QEventLoop, QTimer, QUrl
from PySide6.QtWebEngineCore import (
    QWebEnginePage,
    QWebEngineProfile,
    QWebEngineUrlRequestInterceptor,
)
from PySide6.QtWebEngineWidgets import QWebEngineView
from PySide6.QtWidgets import QApplication

PHONE, DESK, HEIGHT = 390, 1200, 800  # CSS pixels
DRAWN_MS = 300  # after the window changed its width

# Drawings and letters are looked at on the phone with everything unfolded.
LOOK = """(() => {
  document.querySelectorAll("details").forEach(each => { each.open = true; });
  const box = each => each.getBoundingClientRect();
  const name = each => each.tagName + "." + (each.className.baseVal ?? each.className)
    + " " + (each.getAttribute("aria-label") ?? each.textContent).trim().slice(0, 60);
  const drawings = [...document.querySelectorAll("svg, img, figure")]
    .filter(each => !each.closest(".on > .view")); // a chart is in its place
  const letters = [...document.querySelectorAll("svg text")].map(each => box(each).height);
  const inside = each => { // of something that scrolls or cuts
    for (let up = each.parentElement; up && up !== document.body; up = up.parentElement)
      if (getComputedStyle(up).overflowX !== "visible") return true;
    return false;
  };
  const links = [...document.querySelectorAll('a[href^="#"]')].map(a => a.getAttribute("href"));
  return JSON.stringify({
    window: innerWidth, width: document.documentElement.scrollWidth,
    wide: [...document.querySelectorAll("body *")]
      .filter(each => box(each).right > innerWidth + 1 && !inside(each)).map(name).slice(0, 5),
    drawings: drawings.length,
    empty: drawings.filter(each => !(box(each).width && box(each).height)).map(name),
    smallest: letters.length ? Math.min(...letters.filter(Boolean)) : null,
    links: links.length,
    broken: links.filter(href => !document.getElementById(decodeURIComponent(href.slice(1)))),
    text: document.body.innerText.length,
  });
})()"""


class Listening(QWebEnginePage):
    """A page that keeps what is said on its console."""

    def __init__(self, profile):
        super().__init__(profile)
        self.said = []

    def javaScriptConsoleMessage(self, level, message, line, source):  # noqa: N802 - Qt's name
        self.said.append(f"{level.name}: {message} ({Path(source).name}:{line})")


class Asked(QWebEngineUrlRequestInterceptor):
    """Keeps what is asked of disk and network but for the pages themselves."""

    def __init__(self, paths):
        super().__init__()
        self.pages = {QUrl.fromLocalFile(str(Path(path).resolve())) for path in paths}
        self.urls = []

    def interceptRequest(self, info):  # noqa: N802 - Qt's name
        if info.requestUrl() not in self.pages and info.requestUrl().scheme() != "data":
            self.urls.append(info.requestUrl().toString())


def waited(start, *signals):
    """Run the event loop from `start()` until one of `signals` and give what it said."""
    loop, said = QEventLoop(), []

    def done(*values):
        said.extend(values)
        loop.quit()

    for signal in signals:
        signal(done)
    start(done)
    loop.exec()
    return said[0] if said else None


def loaded(view, url):
    return waited(lambda _: view.load(url), view.loadFinished.connect)


def answered(view, script):
    return waited(lambda done: view.page().runJavaScript(script, 0, done))


def looked(view, width):
    view.resize(width, HEIGHT)
    answered(view, 'document.querySelectorAll("details").forEach(each => { each.open = true; })')
    waited(lambda done: QTimer.singleShot(DRAWN_MS, done))
    return json.loads(answered(view, LOOK))


def did(view, page):
    """What the script beside a page answers; the page is printed then."""
    script = page.with_suffix(".js")
    if not script.exists():
        return None
    told = f"var told = null; Promise.resolve({script.read_text('utf-8')})"
    said = ".then(text => { told = text; }, error => { told = JSON.stringify(String(error)); })"
    answered(view, told + said + "; 0")
    while not (answer := answered(view, "told")):  # null is an empty text
        waited(lambda done: QTimer.singleShot(DRAWN_MS, done))
    view.page().printToPdf(str(page.with_suffix(".pdf")))
    waited(lambda _: None, view.page().pdfPrintingFinished.connect)
    return json.loads(answer)


def tell(**found):
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()


def main(paths):
    _application = QApplication(sys.argv[:1])
    profile = QWebEngineProfile()  # without a name it keeps nothing on the disk
    asked = Asked(paths)
    profile.setUrlRequestInterceptor(asked)
    view, page = QWebEngineView(), Listening(profile)
    view.setPage(page)
    view.resize(PHONE, HEIGHT)
    view.show()
    loaded(view, QUrl("data:text/html,<p>works"))
    tell(works=answered(view, "document.body.innerText") == "works")
    for path in paths:
        page.said.clear()
        asked.urls.clear()
        ok = loaded(view, QUrl.fromLocalFile(str(Path(path).resolve())))
        phone, desk = looked(view, PHONE), looked(view, DESK)
        seen = did(view, Path(path))
        tell(
            page=Path(path).stem, loaded=ok, said=page.said, phone=phone, desk=desk, did=seen,
            asked=asked.urls,
        )  # fmt: skip
    os._exit(0)  # Qt's own end takes a second and may complain


if __name__ == "__main__":
    main(sys.argv[1:])
