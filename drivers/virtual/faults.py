"""Faults that a test switches on by name in `world.faults`, e.g. `ft.late`, `ft.status.6`, `ft.lost_second@10`.

A name may carry a number after a dot (which bit, which gauge) and `@N`: on every N-th occasion only.
"""

from galen_hw.drivers.virtual.world import World


class FaultPicker:
    """What is broken on this occasion.

    Args:
        world: whose `faults` are looked at.
        known: the names that this device understands, without number and `@N`.
    """

    def __init__(self, world: World, known: frozenset[str]) -> None:
        self._world, self._known = world, known
        self._seen: set[str] = set()
        self._rules: dict[str, list[tuple[int | None, int]]] = {}
        self._occasions: dict[str, int] = {}
        self._begun: set[str] = set()

    @property
    def any(self) -> bool:
        """Something is broken at all."""
        if self._seen != self._world.faults:
            self._read()
        return bool(self._rules)

    def hits(self, name: str) -> list[int | None]:
        """The numbers of all rules of `name` that strike on this occasion (None: no number given)."""
        if not self.any or name not in self._rules:
            return []
        count = self._occasions[name] = self._occasions.get(name, 0) + 1
        return [number for number, every in self._rules[name] if count % every == 0]

    def strikes(self, name: str) -> bool:
        """Return whether `name` strikes on this occasion."""
        return bool(self.hits(name))

    def begins(self, name: str) -> bool:
        """Return whether `name` was switched on since this was last asked."""
        if not self.any or name not in self._begun:
            return False
        self._begun.discard(name)
        return True

    def _read(self) -> None:
        before = set(self._rules)
        self._rules = {}
        for text in sorted(self._world.faults):
            name, number, every = parse_fault(text)
            if name in self._known:
                self._rules.setdefault(name, []).append((number, every))
        self._begun = (self._begun | (set(self._rules) - before)) & set(self._rules)
        self._seen = set(self._world.faults)


def parse_fault(text: str) -> tuple[str, int | None, int]:
    """Name, number and every-N of a fault's text."""
    name, _, every = text.partition("@")
    stem, _, last = name.rpartition(".")
    if stem and last.isdigit():
        return stem, int(last), _positive(every)
    return name, None, _positive(every)


def _positive(every: str) -> int:
    return max(1, int(every)) if every.isdigit() else 1
