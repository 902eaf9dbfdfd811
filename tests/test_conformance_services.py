"""Every row of SERVICES keeps the contract of `services/service.py`; a row whose module does not load fails."""

import sys
import time
from importlib import import_module
from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict

sys.path.insert(0, str(Path(__file__).parent))

from conformance.check_service import CHECKS, Case

from galen_hw.errors import CommandRejectedError
from galen_hw.messages import Status
from galen_hw.services.service import Service
from galen_hw.services.table import SERVICES


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("service", SERVICES)
def test_service_conforms(service, check, tmp_path, monkeypatch):
    """The service of this row passes this check."""
    monkeypatch.chdir(tmp_path)
    module, _, name = SERVICES[service].partition(":")
    check(Case(service, getattr(import_module(module), name)))


class Sound(Service):
    """Keeps the contract: counts raw wrenches."""

    class Settings(BaseModel):
        model_config = ConfigDict(extra="forbid", frozen=True)

    consumes = ("wrench/raw",)
    produces = ("status",)

    def __init__(self, name, settings, context):
        self.name, self.seq = name, 0

    def handle(self, topic, message, now_ns):
        self.seq += 1
        head = {"timestamp": 0.0, "t_ns": now_ns, "seq": self.seq, "source": self.name}
        return [("status", Status(**head, state="ready"))]

    def request(self, request, now_ns):
        raise CommandRejectedError("no such command")

    def snapshot(self):
        return {"version": 1}

    def restore(self, state):
        return state == {"version": 1}


class FallsOnNan(Sound):
    def handle(self, topic, message, now_ns):
        int(message.force.x)
        return []


class SaysWhatItDidNotDeclare(Sound):
    produces = ("fault",)


class SkipsNumbers(Sound):
    def handle(self, topic, message, now_ns):
        self.seq += 1
        return super().handle(topic, message, now_ns)


class Random(Sound):
    def handle(self, topic, message, now_ns):
        return super().handle(topic, message, time.monotonic_ns())


class TakesEverything(Sound):
    def request(self, request, now_ns):
        return []


class FallsOnArguments(Sound):
    def request(self, request, now_ns):
        if "x" in request.args:
            float(request.args["x"])
        raise CommandRejectedError("no such command")


class TrustsAnySnapshot(Sound):
    def restore(self, state):
        return True


class Forgets(Sound):
    def snapshot(self):
        return {"version": 1, "seq": id(self)}


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (FallsOnNan, "check_survives_any_message"),
        (SaysWhatItDidNotDeclare, "check_survives_any_message"),
        (SkipsNumbers, "check_survives_any_message"),
        (Random, "check_deterministic"),
        (TakesEverything, "check_unknown_request_is_refused"),
        (FallsOnArguments, "check_survives_any_request"),
        (TrustsAnySnapshot, "check_foreign_snapshots_are_refused"),
        (Forgets, "check_snapshot_round_trip"),
    ],
)
def test_checks_find_a_broken_service(broken, check):
    """Each check passes a sound service and fails one that breaks its claim."""
    run = next(c for c in CHECKS if c.__name__ == check)
    run(Case("sound", Sound))
    with pytest.raises(BaseException):  # noqa: B017, PT011 - what comes out depends on how it is broken
        run(Case("broken", broken))
