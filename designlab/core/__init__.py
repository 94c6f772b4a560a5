"""Files and cache, images, image metrics, processes, and the choice of the rendering back end."""

__version__ = "0.1.0"
