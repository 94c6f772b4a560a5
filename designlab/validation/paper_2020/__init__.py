"""The paper's experiments on made sensors whose truth is known, and its tables beside ours.

A. Agarwal, T. Man and W. Yuan, arXiv 2012.13184. The order of the work: `datasets` (what is pressed where),
`hidden` (the true sensor), `photograph` (its pictures).
"""
