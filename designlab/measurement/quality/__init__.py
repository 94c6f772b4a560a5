"""Checks of measured frames before anything is fitted."""
