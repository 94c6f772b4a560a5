"""A camera's own files as linear images."""
