"""Which effects a measurement speaks for."""
