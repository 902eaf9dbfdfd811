"""Each effect with and without, on data that it was not learnt from."""
