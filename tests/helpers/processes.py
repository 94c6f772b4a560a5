"""Programs that run in processes of their own, to be killed."""

import os
import subprocess
import sys
import time


def until(condition, what, *, seconds=120):
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.005)


class Processes:
    """Processes of one program."""

    def __init__(self, program):
        self.program = program
        self.started = []

    def start(self, *words, **variables):
        """Start it with some words and environment variables."""
        environment = os.environ | {"OMP_NUM_THREADS": "1"} | variables
        arguments = [sys.executable, str(self.program), *(str(word) for word in words)]
        process = subprocess.Popen(
            arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.started.append(process)
        return process

    def finish(self, process):
        """Wait for its end, which must be a good one."""
        _, errors = process.communicate(timeout=240)
        assert process.returncode == 0, errors
