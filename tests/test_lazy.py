"""Attributes that are computed once: kept, and two threads that need each other's do not wait for each other."""

import threading

from galen_hw.lazy import cached_property


class Crossed:
    """Each of two attributes needs the other; the one that is asked first waits until the other is being computed too."""

    def __init__(self, first: str, both: threading.Barrier) -> None:
        self.first, self.both = first, both

    def _begun(self, name: str) -> None:
        if name == self.first:
            self.both.wait(5.0)

    @cached_property
    def a(self) -> int:
        """Needs b, unless that has asked for it."""
        self._begun("a")
        return self.b + 1 if self.first == "a" else 1

    @cached_property
    def b(self) -> int:
        """Needs a, unless that has asked for it."""
        self._begun("b")
        return self.a + 1 if self.first == "b" else 1


def test_two_objects_in_two_threads_do_not_wait_for_each_other() -> None:
    """With one lock for an attribute of all objects, as functools' has up to Python 3.11, this stands still."""
    both = threading.Barrier(2)
    one, other, found = Crossed("a", both), Crossed("b", both), []
    threads = [threading.Thread(target=lambda: found.append(one.a), daemon=True)]
    threads.append(threading.Thread(target=lambda: found.append(other.b), daemon=True))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10.0)
    assert found == [2, 2]


def test_it_is_computed_once_and_kept() -> None:
    """The same object again, without a second computation."""
    one = Crossed("", threading.Barrier(2))
    assert one.a == one.a == 1
    assert one.__dict__["a"] == 1
