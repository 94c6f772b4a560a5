"""Files and cache, images, image metrics, processes, and the choice of the rendering back end."""
