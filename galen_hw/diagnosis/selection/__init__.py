"""The search for the effects of a model."""
