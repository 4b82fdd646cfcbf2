"""What a command waits for before its first word."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = {"torch", "numba", "sklearn", "filterpy", "scipy.stats", "scipy.optimize", "scipy.signal"}


@pytest.mark.slow
def test_what_needs_no_network_does_not_wait_for_its_libraries():
    """Of `prepare`, and with it of the configuration, of reading and of pages."""
    script = (
        "import sys, training.config, eval.report.page, narxcal.cli.prepare\n"
        f"found = sorted({HEAVY} & set(sys.modules))\n"
        "sys.exit(f'imported {found}' if found else None)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
