"""Named pieces of physics: rigid bodies first, effects on top; functions of arrays."""
