"""Where a model's steady state and its lags come from, in words: for `train`, `info`, the pages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from narxcal.channels import CHANNELS

_LAGS = {
    "plain": "without limits of acceleration",
    "limits": "with limits of acceleration and deceleration",
    "governed": "behind a control that holds N1",
}
_KINDS = {"fmu": "FMU", "callable": "function"}


def steady_words(meta: Mapping[str, Any]) -> str:
    """What the steady-state model of a bundle rests on; empty where the bundle does not say."""
    found = meta.get("steady_state") or {}
    if not found:
        return ""
    if not found["fitted"]:
        section = meta.get("config", {}).get("steady_state", {})
        kind = section.get("kind", "model")
        return f"the maker's {_KINDS.get(kind, kind)} {section.get('source', '')}".strip()
    left = ", ".join(
        f"{name} {rms:.3g} {CHANNELS[name].unit}".removesuffix(" -")
        for name, rms in found["rms"].items()
    )
    return (
        f"fitted to {found['samples']} quasi-steady samples over {100 * found['coverage']:.0f} % "
        f"of the driver's range{_form(found)}; RMS left: {left}"
    )


def _form(found: Mapping[str, Any]) -> str:
    """How the curves were chosen to be; empty for a bundle of before there was a choice."""
    if "corrected" not in found:
        return ""
    words = ["corrected parameters" if found["corrected"] else "parameters as they are"]
    if found["blend"]:
        words.append(f"blended over {' and '.join(found['blend'])}")
    if found["switches"]:
        words.append(f"shifted by {', '.join(found['switches'])}")
    return f"; {', '.join(words)}"


def lag_words(meta: Mapping[str, Any]) -> str:
    """Which lags stand in front of the network, and what spoke for them; empty without any."""
    found = meta.get("lag_form") or {}
    if not found.get("form"):
        return ""
    left = ", ".join(f"{form} {100.0 * share:.2g} %" for form, share in found["left"].items())
    chosen = f"; chosen by what is left of logs not fitted to: {left}" if left else ""
    return f"{_LAGS[found['form']]}{chosen}"
