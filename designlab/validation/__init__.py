"""Proof of the tool stands here: an independent generator, blind benchmarks, the experiments of 2020."""
