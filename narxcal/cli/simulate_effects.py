"""`narxcal simulate --sim ... --effects ...`: the simulator with the effects that were found.

OUT gets one canonical CSV for each log of inputs, so that anybody can check how far the gap falls.
A simulator that can be run again is given inputs with the effects on them; the document and the
terminal say of each effect how it was applied.
"""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.log import Log
from eval.diagnosis.applied import FoundEffects, read_effects
from eval.diagnosis.pairs import match_simulated, read_folder
from eval.diagnosis.simulators import Simulate, open_simulator
from narxcal.channels import CHANNELS
from narxcal.cli.console import Console
from narxcal.cli.results import read_config
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results, log_csv, recover

SCHEMA, DOCUMENT = "narxcal.simulate_effects/1", "simulated.json"


def run(options: Namespace, console: Console) -> int:
    """Simulate every log of a folder, add the effects, and write the logs as a whole."""
    _check(options)
    results = _results(options.out)
    results.check(options.out)
    found = read_effects(options.effects)
    simulator = open_simulator(options.sim, trust=options.trust)
    how = simulator.how
    found.check(again=not isinstance(how, Path))
    config = None if options.config is None else read_config(options.config, None)[0]
    inputs = read_folder(options.inputs_folder, config)
    source = read_folder(how, config) if isinstance(how, Path) else how
    rows = []
    with results.writing(options.out) as folder, console.progress("Adding") as advance:
        for number, (name, log) in enumerate(inputs.items()):
            advance(number, len(inputs), name)
            sim = match_simulated(name, log, source)
            again = None if isinstance(how, Path) else how
            rows.append(_added(folder, found, (name, log, sim), again))
        document = {
            "schema": SCHEMA,
            "effects": {effect: dict(values) for effect, values in found.values.items()},
            "simulator": simulator.kind,
            "applied": found.ways(again=not isinstance(how, Path)),
            "logs": rows,
        }
        results.write(folder, document)
    _show(console, document, options.out)
    return 0


def _added(
    folder: Path,
    found: FoundEffects,
    logs: tuple[str, Log, Log],
    again: Simulate | None,
) -> dict[str, Any]:
    """Write one log with the effects added, by `again` where the simulator can be run so.

    `logs` are its name, the inputs as they were given, and what the simulator says of them.
    """
    name, given, sim = logs
    outputs = found.added_to(sim, name) if again is None else found.run_again(sim, again, name)
    channels, change = _changed(sim, outputs, found.signals.outputs)
    channels["time_s"] = given.time_s[: len(sim)]
    (folder / f"{name}.csv").write_bytes(log_csv(channels).encode())
    load = found.knows(name) if found.has_load else None
    unknown = {n: int(np.isnan(outputs[n]).sum()) for n in found.signals.outputs}
    return {
        "log": name,
        "samples": len(sim),
        "rms_change": change,
        "load_known": load,
        "blank": {n: count for n, count in unknown.items() if count},
    }


def _results(folder: Path) -> Results:
    """What may stand in the folder: the logs that an earlier run says it wrote there."""
    recover(folder.resolve())
    try:
        logs = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))["logs"]
        names = tuple(f"{row['log']}.csv" for row in logs)
    except (OSError, ValueError, LookupError, TypeError):
        names = ()
    return Results(SCHEMA, DOCUMENT, names)


def _check(options: Namespace) -> None:
    needed = {"--sim": "sim", "--effects": "effects", "--inputs": "inputs_folder"}
    lost = [word for word, name in needed.items() if getattr(options, name) is None]
    if lost:
        raise ConfigError(
            "expected --sim, --effects and --inputs together, but "
            f"{' and '.join(lost)} {'is' if len(lost) == 1 else 'are'} missing"
        )
    if options.bundle is not None:
        raise ConfigError("expected either RUN and INPUTS.csv or --sim, --effects and --inputs")


def _changed(
    sim: Log, outputs: Mapping[str, FloatArray], diagnosed: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Canonical channels in their order, and by how much each diagnosed output was changed."""
    rms = {n: float(np.sqrt(np.nanmean((outputs[n] - sim[n]) ** 2))) for n in diagnosed}
    both = {**sim.channels, **outputs}
    names = [n for n, row in CHANNELS.items() if n in both and row.role != "auxiliary"]
    return {"time_s": sim.time_s, **{name: both[name] for name in names}}, rms


def _show(console: Console, document: Mapping[str, Any], out: Path) -> None:
    names = list(document["logs"][0]["rms_change"])
    console.table(
        "RMS of what the effects change",
        ["log", *names],
        [[r["log"], *(f"{r['rms_change'][n]:.3g}" for n in names)] for r in document["logs"]],
    )
    for row in document["logs"]:
        for channel, count in row["blank"].items():
            console.warn(
                f"{row['log']}: the simulator gives no {channel} in {count} of "
                f"{row['samples']} samples: they are left blank"
            )
    blind = [row["log"] for row in document["logs"] if row["load_known"] is False]
    if blind:
        console.warn(
            f"no channel records the load and no window of it is known in {', '.join(blind)}: it "
            "is not applied there"
        )
    for effect, way in document["applied"].items():
        console.say(f"{effect}: applied {way}")
    console.say(f"Effects: {', '.join(document['effects']) or 'none'}. Logs: {out}")
    console.document({**document, "out": str(out)})
