"""Studies of the Spey paper: claims of its tables, simulated engines."""

import pandas as pd

from eval.reproduce.spey import Trial, coverage, paper_study, truth


def by_start(study):
    """Claims by their number in the list of the paper's claims, or first words."""
    return [(claim.what[:3].strip(), claim.met) for claim in study.claims]


def test_what_the_papers_tables_bear_out_and_what_they_contradict():
    assert by_start(paper_study()) == [
        ("S3", True), ("S5", False), ("S6", False), ("S9", True), ("S10", False),
        ("S2", True), ("S4", False), ("S6", True), ("S7", True), ("S8", True),
    ]  # fmt: skip
    contradicted = [claim for claim in paper_study().claims if claim.met is False]
    assert all(claim.remark for claim in contradicted)
    four = next(claim for claim in contradicted if claim.what.startswith("S4"))
    assert four.value == 4
    assert "C_HL -11 % (significant)" in four.remark


def test_coverage_counts_both_engines_and_pools_what_was_estimated():
    names = ["tau_H", "alpha", "tau_engine"]

    def trial(*errors):
        """Off by so much; deviations of 1, and for coloured residuals such that alpha is missed."""
        tables = {}
        for engine in ("left", "right"):
            value = [truth(engine)[name] + error for name, error in zip(names, errors, strict=True)]
            tables[engine] = pd.DataFrame(
                {"value": value, "sd": 1.0, "coloured": (2, -1, 2)}, names
            )
        return Trial(pd.concat(tables), {}, 1.0)

    # The half width of a 90 % interval is 1.645 standard deviations.
    trials = [trial(1.64, 1.65, 9.0), trial(-1.64, 0.0, 0.0)]
    assert coverage(trials) == {"tau_H": 100.0, "alpha": 50.0, "tau_engine": 50.0, "pooled": 75.0}
    assert coverage(trials, "coloured")["pooled"] == 50.0
