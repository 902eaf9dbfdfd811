"""The answer for people: lines of text, figures, a page."""
