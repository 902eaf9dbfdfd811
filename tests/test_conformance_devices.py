"""Every row of DRIVERS keeps the contract of `drivers/device.py`; a row whose module does not load fails."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from conformance.check_device import CHECKS, Case
from conformance.peer import script_of

from galen_hw.drivers.table import DRIVERS


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("driver", DRIVERS)
def test_device_conforms(driver, check):
    """The driver of this row passes this check."""
    module, _, name = DRIVERS[driver].partition(":")
    check(Case(driver, getattr(import_module(module), name), script_of(driver)))
