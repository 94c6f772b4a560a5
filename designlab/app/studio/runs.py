"""Runs of studies that the studio starts: `designlab study run` in processes of their own."""

import contextlib
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a studio in the background ignores
from designlab.app.cli import main
sys.exit(main(sys.argv[1:]))
"""
COMMAND = (sys.executable, "-c", PROGRAM, "study", "run")
# Exit status of a command that was interrupted; the second where it had not yet read its arguments.
INTERRUPTED = (130, -signal.SIGINT)
LAST_BYTES = 4000
END_S = 10.0


class Runs:
    """Runs by the folder of their study; one at a time in a folder."""

    def __init__(self) -> None:
        self._runs: dict[Path, tuple[subprocess.Popen[bytes], IO[Any]]] = {}

    def start(self, folder: Path) -> None:
        """Start the study of a folder, or go on with it."""
        if self.running(folder):
            return
        if folder in self._runs:
            self._runs.pop(folder)[1].close()
        log = tempfile.TemporaryFile()  # noqa: SIM115  `stop` closes it
        process = subprocess.Popen(
            [*COMMAND, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,  # Ctrl-C for the studio reaches it by `stop` alone
        )
        self._runs[folder] = process, log

    def running(self, folder: Path) -> bool:
        """Whether the studio runs the study."""
        return folder in self._runs and self._runs[folder][0].poll() is None

    def pause(self, folder: Path) -> None:
        """Interrupt the run; what is finished is kept, and `start` goes on."""
        if self.running(folder):
            self._runs[folder][0].send_signal(signal.SIGINT)

    def said(self, folder: Path) -> str:
        """Last line of a run that has failed; empty where none has, paused ones included."""
        if folder not in self._runs or self.running(folder):
            return ""
        process, log = self._runs[folder]
        if process.returncode in (0, *INTERRUPTED):
            return ""
        with contextlib.suppress(OSError, ValueError):
            log.seek(0, 2)
            log.seek(max(0, log.tell() - LAST_BYTES))
            lines = log.read().decode(errors="replace").strip().splitlines()
            return lines[-1] if lines else ""
        return ""

    def stop(self) -> None:
        """Interrupt all runs, and wait for them."""
        for folder in list(self._runs):
            self.pause(folder)
        for process, log in self._runs.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            if process.poll() is None:
                process.terminate()
            log.close()
        self._runs.clear()
