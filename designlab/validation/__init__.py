"""Proof of the tool: an independent generator, blind benchmarks, the experiments of 2020."""
