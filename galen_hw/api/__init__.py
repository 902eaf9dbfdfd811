"""The Python face: what `from galen_hw import ...` gives. Documented, and what is stable is said, in `docs/python.md`."""
