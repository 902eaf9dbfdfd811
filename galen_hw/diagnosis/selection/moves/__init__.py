"""What a search may do to a model."""
