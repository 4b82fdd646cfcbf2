"""How often `compare` claims a difference of equal models, and how often it finds one.

Errors are first-order (AR(1)) with a correlation time of 0 to 100 s, with and without an offset of
each model in each flight, over one to eight flights of ten minutes; three equal models in one
channel, so that any claim is false. Power is the share of tables that find a fourth model whose
errors are 1.5 times as large. `python -m eval.benchmarks.comparisons`
"""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from eval.judging.significance import Recording, differences
from narxcal.support.arrays import FloatArray

DURATION_S, DT_S, MODELS, LARGER = 600.0, 0.5, 3, 1.5
TAUS_S, FLIGHTS = (0.0, 1.0, 5.0, 20.0, 50.0, 100.0), (1, 2, 3, 5, 8)


class Rate(NamedTuple):
    """Tables with a false claim, those that find the larger error, and how many tables."""

    claims: int
    found: int
    tables: int


def false_claims(tau_s: float, flights: int, tables: int, *, offsets: bool, seed: int = 0) -> Rate:
    """Compare equal models in `tables` tables; `offsets` have twice the size of the errors."""
    rng = np.random.default_rng(seed)
    claims = found = 0
    for _ in range(tables):
        recordings = [_recording(rng, tau_s, name, offsets=offsets) for name in range(flights)]
        equal = [f"model {k}" for k in range(MODELS)]
        claims += any(one.significant for one in differences(recordings, equal))
        pair = differences(recordings, [equal[0], "larger"])
        found += any(one.significant and one.better == equal[0] for one in pair)
    return Rate(claims, found, tables)


def _recording(rng: np.random.Generator, tau_s: float, number: int, *, offsets: bool) -> Recording:
    count = round(DURATION_S / DT_S)
    errors = {f"model {k}": _error(rng, tau_s, count, offsets=offsets) for k in range(MODELS)}
    errors["larger"] = LARGER * _error(rng, tau_s, count, offsets=offsets)
    time_s = DT_S * np.arange(count, dtype=np.float64)
    every = np.ones(count, dtype=np.bool_)
    truth = np.zeros((count, 1))
    return Recording(f"flight {number}", time_s, ("N1_pct",), truth, errors, every)


def _error(rng: np.random.Generator, tau_s: float, count: int, *, offsets: bool) -> FloatArray:
    """Error (count, 1) of unit variance, stationary from its first sample."""
    a = np.exp(-DT_S / tau_s) if tau_s > 0.0 else 0.0
    drive = rng.normal(size=count) * np.sqrt(1.0 - a * a)
    drive[0] = rng.normal()
    error = lfilter([1.0], [1.0, -a], drive)
    return np.asarray(error + 2.0 * offsets * rng.normal())[:, None]


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    tables, seed = given.tables, given.seed
    _say(f"{'flights':>8}{'offsets':>9}" + "".join(f"{f'tau {t:g} s':>18}" for t in TAUS_S))
    for flights in FLIGHTS:
        for offsets in (False, True) if flights > 1 else (False,):
            rates = [
                false_claims(tau, flights, tables, offsets=offsets, seed=seed) for tau in TAUS_S
            ]
            cells = "".join(
                f"{100.0 * one.claims / tables:>8.1f} %, {100.0 * one.found / tables:>3.0f} %"
                f"{'':>1}"
                for one in rates
            )
            _say(f"{flights:>8}{'yes' if offsets else 'no':>9}{cells}")
    _say("false claims at a nominal 5 %, and how often an error 1.5 times as large is found")


if __name__ == "__main__":
    main()
