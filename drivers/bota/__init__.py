"""Bota Systems force/torque sensors through the vendor's package; nothing is imported here, so that `process` starts quickly."""
