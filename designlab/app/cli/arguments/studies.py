"""Arguments of the commands on many designs: study, tolerance."""

import os
from typing import Any

from designlab.app.cli.arguments.options import (
    AGAIN,
    FIDELITIES,
    MODEL_HELP,
    Parser,
    option,
    out,
    presses,
    seed,
    whole,
    workers,
)

STORAGE_VARIABLE = "DESIGNLAB_STORAGE"
"""Environment variable with the URL of the database that records of studies lie in."""

_STUDY = "designlab.app.cli.study"


def add_study(add: Any) -> None:
    """Add study and its actions."""
    study = add("study", "", "search for better designs; resumable, many workers")
    actions = study.add_subparsers(metavar="ACTION", required=True, parser_class=Parser)
    run = add("run", f"{_STUDY}:run", "evaluate designs until the study is done", to=actions, resume=AGAIN)
    status = add("status", f"{_STUDY}:status", "how far a study is, and its best designs", to=actions)
    report = add("report", f"{_STUDY}:report", "one HTML page about a study", to=actions)
    for action in (run, status, report):
        option(action, "study STUDY", "study file (TOML), or the folder of its results")
        option(
            action,
            "--storage URL",
            "database that holds the record, for runs on several machines, "
            f"postgresql+psycopg://user@host/name (default: {STORAGE_VARIABLE} if set, else the folder)",
            default=os.environ.get(STORAGE_VARIABLE),
        )
    out(run, "folder of the results (default: STUDY without .toml, with -out)", required=False)
    out(status, "folder of the results, where `run` had one", required=False)
    option(report, "--results DIR", "folder of the results, where `run` had --out")
    option(report, "-o --output FILE", "page to write (default: report.html there)")
    workers(run)
    presses(run)
    option(run, "--trials N", "designs in all, instead of the study's own", type=whole(1, 100_000))
    option(run, "--budget TIME", "time in all, such as 10min: fewer designs and a shorter confirmation")
    option(run, "--no-confirm", "do not evaluate the best designs again")
    option(run, "--rebuild", "make a new record of the scores kept; the old one stays")


def add_tolerance(add: Any) -> None:
    """Add tolerance."""
    command = add(
        "tolerance",
        "designlab.app.cli.tolerance:tolerance",
        "copies of a design as they would be built: how many are good, and what is to blame",
        resume=AGAIN,
    )
    option(command, "design DESIGN", MODEL_HELP)
    option(command, "--terms FILE", "TOML file: what a copy must score, what differs between copies")
    option(command, "--copies N", "how many (default: 200)", type=whole(2, 100_000), default=200)
    option(
        command, "--calibrate", "calibrate each copy, or the drawing once for all", choices=("each", "once")
    )
    option(command, "--fidelity", "effort", choices=FIDELITIES)
    workers(command)
    option(command, "--dask ADDRESS", "Dask scheduler whose workers run the copies, tcp://host:8786")
    out(command, "folder of the copies and the report; the same command again goes on there")
    seed(command)
