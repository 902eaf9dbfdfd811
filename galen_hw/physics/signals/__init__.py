"""Signals cleaned and differentiated."""
