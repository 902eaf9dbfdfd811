"""Fuzzing of whatever reads foreign bytes: `make fuzz`; the same targets run with Hypothesis in the tests."""
