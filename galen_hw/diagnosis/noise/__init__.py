"""The noise of the readings: its spectrum and its low-frequency part."""
