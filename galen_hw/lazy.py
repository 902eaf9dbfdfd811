"""Attributes that are computed once, without a lock.

Until Python 3.12 `functools.cached_property` holds one lock for an attribute of all objects of a class while it computes: two
threads that ask two recordings for two attributes, each of which needs the other one, wait for each other for ever.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from functools import cached_property
else:

    class cached_property:  # noqa: N801 - it stands for the one of functools
        """Compute an attribute when it is asked first and keep it in the object; two threads may both compute it."""

        def __init__(self, compute: Any) -> None:
            self.compute, self.__doc__ = compute, compute.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self.name = name

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            kept = instance.__dict__
            if self.name not in kept:
                kept[self.name] = self.compute(instance)
            return kept[self.name]


__all__ = ["cached_property"]
