"""Looks that several views share, as Quasar's props."""

FILLED = "no-caps unelevated color=chosen text-color=onchosen"
"""Of a button that is filled."""
TOGGLE = "dense no-caps unelevated toggle-color=chosen toggle-text-color=onchosen"
"""Of buttons of which one is chosen."""
