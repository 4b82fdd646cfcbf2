"""Short pieces of virtual flights, and what every page of ours has to be."""

import base64
import hashlib
import json
import re
import signal
import subprocess
import sys
from functools import lru_cache
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, settings

from narxcal.atmosphere import air_state
from narxcal.export import ExportOptions, Grid, export_table
from narxcal.flight_test.fly import fly
from narxcal.flight_test.scenario import FlightScenario
from narxcal.steady.function import SteadyCallable
from narxcal.turbofan import VirtualEngine
from narxcal.turbofan.engine import INPUT_NAMES

# A busy machine is no failure, and a clone has the draws of every other one; a few of them, for
# what is drawn anew, and more, is `make fuzz`.
PATIENT = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
settings.register_profile("same", PATIENT, derandomize=True, max_examples=25)
settings.register_profile("drawn", PATIENT, max_examples=400, print_blob=True)
settings.load_profile("same")

# The shortest flight there is; a piece begins on the initial climb, where the lever is busy.
WHOLE_S, FROM_S = 480.0, 40.0
NODES = {
    "TRA_deg": (0.0, 15.0, 30.0, 50.0, 70.0, 85.0),
    "ALT_ft": (-1000.0, 10_000.0, 20_000.0, 30_000.0, 40_000.0),
    "Mach": (0.0, 0.3, 0.6, 0.85),
    "dT_C": (-30.0, 20.0),
}


@pytest.fixture(scope="session", autouse=True)
def ctrl_c():
    """Ctrl-C as at a terminal: a shell starts its background jobs deaf to it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


class Piece(NamedTuple):
    """Channels (time,) of a piece of a flight: what was recorded, and what the engine did."""

    recorded: dict
    true: dict

    def to_csv(self, path):
        pd.DataFrame(self.recorded).to_csv(path, index=False, float_format="%.8g")

    def true_to_csv(self, path):
        table = pd.DataFrame({"time_s": self.recorded["time_s"], **self.true})
        table.to_csv(path, index=False, float_format="%.8g")


@lru_cache(maxsize=32)
def flown(seed, rate_hz):
    table = {
        "seed": seed,
        "flights": 1,
        "engines": ["left"],
        "build_scatter_pct": 0.0,
        "outputs": ["N1_pct", "N2_pct", "EGT_C", "FF_kgph"],
        "plan": {"duration_s": WHOLE_S, "rate_hz": rate_hz},
    }
    (log,) = fly(FlightScenario.parse(table), 1)
    return log


def piece(seed, duration_s=150.0, rate_hz=8.0):
    log = flown(seed, rate_hz)
    begin = round(FROM_S * rate_hz)
    kept = slice(begin, begin + round(duration_s * rate_hz))
    recorded = {name: values[kept].copy() for name, values in log.recorded.items()}
    recorded["time_s"] = np.arange(len(recorded["time_s"])) / rate_hz
    return Piece(recorded, {name: values[kept] for name, values in log.true.items()})


@pytest.fixture(name="piece", scope="session")
def _piece():
    """A piece of the flight of a seed, by the engine that `narxcal.turbofan` describes."""
    return piece


def curves(inputs):
    """N1, N2 and EGT (..., 3) at (..., 9): corrected speed by lever and idle, then by the air."""
    lever, altitude, mach, dT, ground, approach, ecs, nai, wai = np.moveaxis(inputs, -1, 0)
    root = np.sqrt(air_state(altitude, mach, dT).theta2)
    idle = np.where(ground > 0.5, 0.22, np.where(approach > 0.5, 0.36, 0.28))
    share = np.clip(lever / 85.0, 0.0, 1.0)
    n = idle + (1.0 - idle) * share**1.15 - 0.007 * share * (nai + wai)
    temperature = 600.0 + 520.0 * n**2 + 150.0 * (1.0 - n) ** 4
    bleed = 5.0 * ecs + 12.0 * nai + 8.0 * wai
    settled = 100.0 * n * root, 38.0 * root + 62.0 * n**0.75 * root, temperature * root**2 + bleed
    return np.stack(settled, axis=-1) - np.array([0.0, 0.0, 273.15])


@pytest.fixture(scope="session")
def maker():
    """The curves as a steady-state model with the inputs of the virtual engine."""
    return SteadyCallable(curves, (INPUT_NAMES, ("N1_pct", "N2_pct", "EGT_C")))


@pytest.fixture(scope="session")
def maker_table(tmp_path_factory):
    """The `[steady_state]` section of a coarse table of that engine: quicker than solving it."""
    every = {"WOW": (0.0, 1.0), "Approach": (0.0, 1.0), "ECS": (1.0,), "NAI": (0.0,), "WAI": (0.0,)}
    model, path = VirtualEngine(), tmp_path_factory.mktemp("maker") / "maker.csv"
    grid = Grid({name: every.get(name, NODES.get(name)) for name in model.input_names})
    export_table(model, grid, path, ExportOptions(refine=False, probes=1))
    varying = [name for name in model.input_names if name not in {"ECS", "NAI", "WAI"}]
    return {"kind": "table", "source": str(path), "inputs": varying}


@pytest.fixture(scope="session")
def write_pieces():
    """Write `flight_1.csv` ... of consecutive seeds into a folder; returns their paths."""

    def write(folder, seed, flights, duration_s=150.0, rate_hz=32.0):
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"flight_{number}.csv" for number in range(1, flights + 1)]
        for number, path in enumerate(paths):
            piece(seed + number, duration_s, rate_hz).to_csv(path)
        return paths

    return write


class Page(HTMLParser):
    """Collects the ids, links, resources and text of a page, and checks that tags are nested."""

    VOID = frozenset(("meta", "link", "input", "br", "hr", "img"))

    def __init__(self):
        super().__init__()
        self.stack, self.tags, self.ids, self.anchors, self.resources = [], [], [], [], []
        self.text, self.unnamed = [], 0

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        if tag not in self.VOID:
            self.stack.append(tag)
        if tag == "svg":
            self.unnamed += found.get("role") != "img" or not found.get("aria-label")
        if "id" in found:
            self.ids.append(found["id"])
        href = found.get("href") or found.get("xlink:href") or found.get("src")
        if href:
            (self.anchors if href.startswith("#") else self.resources).append(href.lstrip("#"))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.stack.pop()

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


SCRIPT = "<script>(.*?)</script>"
POLICY = "default-src 'none'; (?:script-src ([^;]*); )?style-src 'unsafe-inline'; img-src data:\""


def hashed(script):
    """The hash by which a content security policy allows a script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


@pytest.fixture(scope="session")
def sound_page():
    """Parse a page that has to be well-formed and to need nothing but itself.

    Its scripts are those that its policy allows by their hashes.
    """

    def read(html):
        page = Page()
        page.feed(html)
        page.close()
        assert page.stack == []
        allowed, scripts = re.search(POLICY, html)[1], re.findall(SCRIPT, html, re.DOTALL)
        assert (allowed or "").split() == [hashed(script) for script in scripts]
        assert page.tags.count("script") == len(scripts)
        assert len(page.ids) == len(set(page.ids))
        assert set(page.anchors) <= set(page.ids)
        assert all(resource.startswith("data:") for resource in page.resources)
        bare = re.sub(SCRIPT, "", html, flags=re.DOTALL)
        assert not re.search(r"url\((?!#)|@import|https?://(?!www\.w3\.org/)", bare)
        return page

    return read


BROWSER = Path(__file__).with_name("browser.py")
LEAST_LETTER_PX = 6.0  # of a figure on a phone, whose pixels are a third of a millimetre


@pytest.fixture(scope="session")
def browse(tmp_path_factory):
    """Open pages (name -> HTML) in a browser engine and give what it found, one dict per page.

    A page with a script in `acts` is printed after it as `pdf`.
    Skips where the engine is not installed or does not start; a fault after that is one.
    """

    def opened(pages, acts=None):
        folder = tmp_path_factory.mktemp("pages")
        paths = [folder / f"{name}.html" for name in pages]
        for path, html in zip(paths, pages.values(), strict=True):
            path.write_text(html, encoding="utf-8")
        for name, script in (acts or {}).items():
            (folder / f"{name}.js").write_text(script, encoding="utf-8")
        out, err = folder / "out", folder / "err"
        with out.open("w") as told, err.open("w") as complained:
            command = [sys.executable, str(BROWSER), *map(str, paths)]
            running = subprocess.Popen(command, stdout=told, stderr=complained)
            try:
                code = running.wait(60 + 20 * len(pages))
            except subprocess.TimeoutExpired:
                running.kill()
                code = running.wait()
        found = [json.loads(line) for line in out.read_text().splitlines()]
        last = [line for line in err.read_text().splitlines() if line.strip()][-1:]
        if found[:1] != [{"works": True}]:
            pytest.skip(f"no browser engine (ended with {code}): {' '.join(last)}")
        assert code == 0, f"the engine ended with {code}: {' '.join(last)}"
        return [{**one, "pdf": folder / f"{one['page']}.pdf"} for one in found[1:]]

    return opened


@pytest.fixture(scope="session")
def sound_in_a_browser(browse):
    """Open pages (name -> HTML): nothing complains, is empty, cut, tiny or leads nowhere."""

    def look(pages):
        seen = browse(pages)
        assert [one["page"] for one in seen] == list(pages)
        for one in seen:
            assert one["loaded"], one["page"]
            assert one["said"] == [], one["page"]
            for window in (one["phone"], one["desk"]):
                assert window["wide"] == [], one["page"]
                assert window["width"] <= window["window"], one["page"]
                assert window["empty"] == [], one["page"]
                assert window["broken"] == [], one["page"]
                assert window["text"] > 100, one["page"]
            smallest = one["phone"]["smallest"]
            assert smallest is None or smallest >= LEAST_LETTER_PX, one["page"]

    return look
