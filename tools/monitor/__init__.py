"""The parts of `galen-hw monitor`: what was heard of the bus, and how it is shown."""
