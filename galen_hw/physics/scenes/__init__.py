"""One compared quantity a file: what was measured, simulated, and how sensitive it is."""
