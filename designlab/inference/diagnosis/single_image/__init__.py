"""Diagnosis of a single picture of a press, which has nothing to compare with but itself.

`blocks` parts the picture into what is fitted to and what judges, `search` is the race on them, `structure`
how well fine structure is reproduced, `diagnose` does all of it.
"""
