"""The parts of `galen-hw calibrate`: poses from a sweep or a recording, the fit, the live check, screen and report."""
