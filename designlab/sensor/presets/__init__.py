"""Published and built-in sensors as TOML files.

Each figure carries its source, each guess is marked as an assumption.
"""
