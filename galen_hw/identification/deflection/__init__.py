"""Deflection: what the arm gives under load, from tracker data to a model that corrects the pose."""
