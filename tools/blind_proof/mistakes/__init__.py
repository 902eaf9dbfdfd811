"""Ordinary mistakes: right recordings with one mistake each, what the program says of them, and whether that is right.

Shares no code and no formula with the tool that is judged; import-linter forbids it both ways.
"""
