"""Calibration: the sweep through the poses, each held until it is still, and what it may and may not do."""
