"""Structure that a model leaves, found and predicted without a name."""
