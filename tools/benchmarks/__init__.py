"""The promised figures, measured: `make bench`; run from a clone, not for the wheel."""
