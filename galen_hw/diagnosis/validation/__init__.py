"""Each effect with and without, on held-out data."""
