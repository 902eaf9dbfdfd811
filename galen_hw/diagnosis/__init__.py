"""Locate, name, model and prove what a model left out of a recording; `galen_hw.diagnose` is the face."""
