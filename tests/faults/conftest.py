"""Processes that tests may kill."""

import pytest
from killing import Processes


@pytest.fixture
def processes(request, tmp_path):
    """Processes of the test module's PROGRAM; killed at the end whatever happens."""
    program = tmp_path / "program.py"
    program.write_text(request.module.PROGRAM)
    found = Processes(program)
    yield found
    for process in found.started:
        process.kill()
        process.communicate()
