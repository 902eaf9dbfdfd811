"""Leads a set-up's wires to the virtual robot."""

from contextlib import ExitStack

from galen_hw.config.load import Setup, Tables
from galen_hw.config.paths import Addresses


def virtual_setup(setup: Setup, tables: Tables, addresses: Addresses, stack: ExitStack) -> Setup:
    """Start the virtual robot, ended with `stack`, and return the set-up with its wires."""
    raise NotImplementedError
