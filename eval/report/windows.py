"""Where the model may reach 10 % and 90 % of its response, as every figure shades it."""

from __future__ import annotations

from eval.report.content import Response
from eval.rules import rules, tolerance_windows


def allowed_times(response: Response) -> list[tuple[float, float]]:
    """(start, stop) on the log's clock for t10 and t90; empty where nothing was judged.

    With a model that was read, the second window starts from the model's own t10 where the rule
    set counts Tt from there, so that a curve inside its windows is one that passed.
    """
    flight, model, verdict = response.flight, response.model, response.verdict
    if verdict is None or flight.reason is not None:
        return []
    if model is None or verdict.Ti is None or verdict.Tt is None:
        bands = tolerance_windows(flight, rules(verdict.rules))
        return [(band.start_s, band.stop_s) for band in bands]
    pairs = ((model.t10_s, verdict.Ti), (model.t90_s, verdict.Tt))
    middles = [(reached_s - check.error_s, check.allowed_s) for reached_s, check in pairs]
    return [(middle - allowed_s, middle + allowed_s) for middle, allowed_s in middles]
