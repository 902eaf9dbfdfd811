"""Effects of one recording, proposed by looking at a residual."""
