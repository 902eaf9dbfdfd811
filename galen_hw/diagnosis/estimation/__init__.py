"""A model's parameters: the data, regressors, least squares, what is not linear, and the errors."""
