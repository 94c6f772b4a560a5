"""The command line: `designlab COMMAND ...`. Nothing heavy is imported before a command needs it."""

from designlab.app.cli.console import main

__all__ = ["main"]
