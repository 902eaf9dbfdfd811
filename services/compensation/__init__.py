"""Compensation: every wrench less what gravity, the sensor's bias and the saved effects account for."""
