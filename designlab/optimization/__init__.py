"""Search for better designs, and their yield under build tolerances."""
