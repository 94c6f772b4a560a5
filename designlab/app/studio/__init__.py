"""The studio: a live page in the browser, where a knob is turned and what the sensor sees follows."""
