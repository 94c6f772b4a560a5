"""The light probe: a chrome ball in a sensor without its gel shows from where light arrives.

P. Debevec, SIGGRAPH 1998; for tactile sensors A. Agarwal, T. Man and W. Yuan, arXiv 2012.13184.
"""
