"""`galen-hw bridge`: the live bus for viewers and systems that speak something else."""
