"""Tests of designlab and geometries: the folders mirror theirs, and what kind a test is says its marker."""

from pathlib import Path

ROOT = Path(__file__).parents[1]  # of the checkout
