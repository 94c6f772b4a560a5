"""From a design and a press to a picture."""
