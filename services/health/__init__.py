"""Whether the daemon, its devices and the calibration in use still do what they should."""
