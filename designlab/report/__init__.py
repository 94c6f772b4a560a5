"""How results are shown: plots, words, self-contained HTML pages, folders of results."""
