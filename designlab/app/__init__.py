"""The command line, the demo and the check of a machine."""
