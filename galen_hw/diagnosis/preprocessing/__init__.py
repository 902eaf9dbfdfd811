"""Rows and channels that can be compared."""
