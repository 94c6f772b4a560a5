"""Rendering: the only part of designlab that imports Mitsuba and Dr.Jit."""
