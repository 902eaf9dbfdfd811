"""`galen-hw collect`: a guided session with the tracker, set after set."""
