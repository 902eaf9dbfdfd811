"""The deflection service: the tool's tip under load, from a saved model, sample by sample."""
