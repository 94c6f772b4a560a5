"""From a measurement to parameters and named effects."""
