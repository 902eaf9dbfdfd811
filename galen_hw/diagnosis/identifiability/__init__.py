"""Effects that would do as well, and the motion that would tell them apart."""
