"""The command studio: the live page in the browser."""

import importlib.util
from argparse import Namespace
from pathlib import Path

from designlab.app.cli.console import Result


def studio(args: Namespace) -> Result:
    """Serve the live page until Ctrl-C ends it."""
    if importlib.util.find_spec("nicegui") is None:
        raise RuntimeError("studio: needs NiceGUI: pip install 'designlab[studio]'")
    from designlab.app.studio.opened import opened
    from designlab.app.studio.server import serve

    address = serve(opened(args.thing, Path.cwd()), host=args.host, port=args.port)
    return Result({"address": address}, "the studio has ended")
