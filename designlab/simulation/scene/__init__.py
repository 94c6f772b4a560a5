"""The scene that is rendered, as plain data."""
