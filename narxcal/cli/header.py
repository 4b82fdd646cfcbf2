"""What every page says about the model it judges and where it comes from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_prep.log import Log, Source
from eval.report.content import RunHeader
from eval.rules import Tolerance, rules
from narxcal.cli.origin import lag_words, steady_words

if TYPE_CHECKING:
    from narxcal.bundle import Bundle


def now() -> str:
    """The time that a page bears."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


def header_of(
    title: str, run: Path, bundle: Bundle, logs: Sequence[Log], rule_set: str
) -> RunHeader:
    """Fill a header from what the bundle in `run` holds; `rule_set` names the Ti/Tt rules."""
    meta, found = bundle.meta, rules(rule_set)
    narx = bundle.calibration.narx.config
    return RunHeader(
        title=title,
        created=now(),
        run=str(run),
        model=f"NARX, lags {narx.lags}, hidden units {narx.hidden}, over "
        f"{', '.join(bundle.calibration.input_names)}",
        rules=found.name,
        tolerances=f"Ti {words(found.Ti)}; Tt {words(found.Tt)} ({found.source})",
        sources=data_files(logs),
        versions=meta.get("versions", {}),
        facts=_facts(meta),
        config=json.dumps(meta.get("config", {}), indent=1),
    )


def data_files(logs: Sequence[Log]) -> list[Source]:
    """Every recording once, however many parts it was split into."""
    return list({(log.source.file, log.source.engine): log.source for log in logs}.values())


def words(tolerance: Tolerance) -> str:
    """Spell a tolerance out."""
    floor = f" or {tolerance.floor_s:g} s" if tolerance.floor_s else ""
    return f"±{100.0 * tolerance.share:g} %{floor}"


def _facts(meta: dict[str, Any]) -> dict[str, str]:
    split = meta.get("split") or {}
    training = meta.get("training") or {}
    facts = {f"{part.capitalize()} logs": ", ".join(logs) for part, logs in split.items() if logs}
    facts["Steady state"] = steady_words(meta)
    facts["Lags"] = lag_words(meta)
    facts["Seeds"] = ", ".join(map(str, meta.get("seeds") or []))
    if training:
        facts["Training"] = f"{training.get('status', '')}, {training.get('wall_s', 0.0):.0f} s"
    facts["Hardware"] = ", ".join(str(value) for value in (meta.get("hardware") or {}).values())
    return {name: text for name, text in facts.items() if text}
