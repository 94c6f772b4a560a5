"""The main job end to end on a small budget, see `demo`."""

from designlab.app.demo.run import Demo, demo

__all__ = ["Demo", "demo"]
