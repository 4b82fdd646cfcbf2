"""A real Dask scheduler and real workers, each a process that the test starts and stops."""

import os
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


class Servers:
    """A scheduler and workers that the test starts and stops."""

    def __init__(self, stack):
        self.stack = stack
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"

    def _started(self, *arguments, **environment):
        """Started with a pipe to its end: no process outlives the test."""
        found = {**os.environ, "PYTHONPATH": f"{ROOT}", "OMP_NUM_THREADS": "1", **environment}
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            env=found,
            cwd="/",  # which would come before the path of the environment
            stderr=subprocess.DEVNULL,
        )
        self.stack.callback(process.wait)
        # A nanny that is killed leaves its worker behind.
        self.stack.callback(process.terminate if "--no-nanny" not in arguments else process.kill)
        return process

    def scheduler(self, **environment):
        where = ("--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")
        return self._started("distributed.cli.dask_scheduler", *where, **environment)

    def worker(self, options=(), *, threads=1, nanny=False, **environment):
        """One process; with a nanny two, of which the second is started anew when it dies."""
        how = (*options, "--nthreads", str(threads), "--no-dashboard")
        how += () if nanny else ("--no-nanny",)
        return self._started("distributed.cli.dask_worker", self.address, *how, **environment)
