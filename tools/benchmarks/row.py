"""One line of the page of benchmarks."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One promised figure and what was measured."""

    what: str
    promised: str
    measured: str
    good: bool
    command: str

    @property
    def line(self) -> str:
        """Return its line of the page's table."""
        reached = "yes" if self.good else "**no**"
        return f"| {self.what} | {self.promised} | {self.measured} | {reached} | {self.command} |"
