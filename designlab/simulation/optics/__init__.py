"""Lines of sight through window and gel, and defocus."""
