"""What holds for every service of the table SERVICES: plain functions, each a claim about one `Case`.

Messages are drawn from their own types: NaN, infinities, gaps, repeats, time that goes back, joints nobody has.
"""

import json
import math
import tempfile
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.errors import GalenError
from galen_hw.kinematics import GALEN_JOINTS, GalenRobot
from galen_hw.messages import TOPICS, CommandError, Message, Reply, Request, encode
from galen_hw.services.service import Service, ServiceContext

TIME_BASE = TimeBase(1_700_000_000_000_000_000)
START_NS = 100 * NS_PER_S
FUZZ = settings(
    max_examples=25, phases=[Phase.generate], deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


@dataclass(frozen=True)
class Case:
    """One row of SERVICES."""

    name: str
    cls: type[Service]

    @contextmanager
    def service(self, identity: str = "this robot") -> Iterator[Service]:
        """A fresh one with its default settings and an empty state directory."""
        with tempfile.TemporaryDirectory() as folder:
            context = ServiceContext(GalenRobot(), TIME_BASE, Path(folder), identity, virtual=True)
            made = self.cls(self.name, self.cls.Settings(), context)
            try:
                yield made
            finally:
                made.close()


def check_table_row(case: Case) -> None:
    """The class is a service; its topics are in the table; what it produces it names."""
    assert issubclass(case.cls, Service)
    assert set(case.cls.consumes) <= TOPICS.keys()
    assert set(case.cls.produces) <= TOPICS.keys()
    assert len(set(case.cls.consumes)) == len(case.cls.consumes)


def check_settings(case: Case) -> None:
    """All settings have defaults, unknown keys are refused, nothing can be changed later."""
    made = case.cls.Settings()
    with pytest.raises(ValidationError):
        case.cls.Settings(no_such_key_=1)
    assert case.cls.Settings.model_validate(made.model_dump()) == made


def check_survives_any_message(case: Case) -> None:
    """No sequence of well-typed messages raises; outputs are of declared topics, named, counted and encodable."""

    @FUZZ
    @given(histories(case.cls.consumes))
    def fuzz(history: list[tuple[str, Message]]) -> None:
        with case.service() as service:
            outputs = play(service, history)
            judge(case, outputs)
            json.dumps(service.snapshot(), allow_nan=True)

    fuzz()


def check_deterministic(case: Case) -> None:
    """The same messages at the same times give the same outputs, byte for byte: it can be replayed."""

    @FUZZ
    @given(histories(case.cls.consumes))
    def fuzz(history: list[tuple[str, Message]]) -> None:
        with case.service() as first, case.service() as second:
            assert encoded(play(first, history)) == encoded(play(second, history))

    fuzz()


def check_unknown_request_is_refused(case: Case) -> None:
    """A command that it does not know is refused in words, and so is a second one."""
    with case.service() as service:
        for _ in range(2):
            with pytest.raises(GalenError) as caught:
                service.request(Request(id="1", target=case.name, name="no_such_command"), START_NS)
            assert caught.value.what


def check_survives_any_request(case: Case) -> None:
    """Any name with any arguments gives outputs or a refusal in words, never another exception."""
    names = st.sampled_from(_command_words(case.cls)) | st.text(max_size=8)
    values = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.just({"roll": math.nan})
    keys = st.sampled_from(_command_words(case.cls)) | st.text(max_size=8)

    @FUZZ
    @given(st.lists(st.tuples(names, st.dictionaries(keys, values, max_size=3)), max_size=6))
    def fuzz(requests: list[tuple[str, dict[str, Any]]]) -> None:
        with case.service() as service:
            for n, (name, args) in enumerate(requests):
                request = Request(id=str(n), target=case.name, name=name, args=_inside(args))
                judge(case, answer(service, request, START_NS + n))

    fuzz()


def check_unknown_arguments_are_refused(case: Case) -> None:
    """No command is carried out with an argument that it does not take, for a misspelt one would mean a default.

    But a stop and a switching off: who wants that gets it.
    """
    for name in _command_words(case.cls):
        with case.service() as service:
            before = service.snapshot()
            request = Request(id="1", target=case.name, name=name, args={"enabled": True, "no_such_argument": 1})
            if name != "stop":
                assert answer(service, request, START_NS) == [], name
                assert service.snapshot() == before


def check_survives_any_reply(case: Case) -> None:
    """Answers that it never asked for, and errors, are taken."""
    with case.service() as service:
        for reply in (Reply(id="?"), Reply(id="", error=CommandError(kind="timeout", what="no answer"))):
            judge(case, service.reply(reply, START_NS))


def check_snapshot_round_trip(case: Case) -> None:
    """Its own snapshot is taken back (JSON can hold it) and gives the same snapshot again."""
    with case.service() as service:
        kept = json.loads(msgspec.json.encode(service.snapshot()))
    with case.service() as again:
        assert again.restore(kept)
        assert json.loads(msgspec.json.encode(again.snapshot())) == kept


def check_foreign_snapshots_are_refused(case: Case) -> None:
    """Another version, no map of its own, or nonsense: False, and the service works on."""
    with case.service() as service:
        fresh = json.loads(msgspec.json.encode(service.snapshot()))
        for foreign in ({**fresh, "version": 999_999}, {"version": "x"}, {}):
            assert service.restore(foreign) is False
            judge(case, service.tick(START_NS))


CHECKS = (
    check_table_row,
    check_settings,
    check_survives_any_message,
    check_deterministic,
    check_unknown_request_is_refused,
    check_survives_any_request,
    check_unknown_arguments_are_refused,
    check_survives_any_reply,
    check_snapshot_round_trip,
    check_foreign_snapshots_are_refused,
)


def play(service: Service, history: list[tuple[str, Message]]) -> list[Any]:
    """Everything that a service makes of messages and of time that passes."""
    outputs: list[Any] = []
    now_ns = START_NS
    for topic, message in history:
        outputs += service.handle(topic, message, now_ns)
        now_ns += NS_PER_S // 10
        outputs += service.tick(now_ns)
    return outputs


def answer(service: Service, request: Request, now_ns: int) -> list[Any]:
    """Outputs of a request; none when it is refused, which must be in words."""
    refusal: GalenError | None = None
    try:
        return service.request(request, now_ns)
    except GalenError as error:
        refusal = error
    assert refusal.what
    return []


def judge(case: Case, outputs: list[Any]) -> None:
    """Outputs are of the declared topics, bear the service's name, count up by one, and can be sent."""
    last: dict[str, int] = {}
    for output in outputs:
        if not isinstance(output, tuple):
            assert isinstance(output, Request | Reply)
            encode(output)
            continue
        topic, message = output
        assert topic in case.cls.produces, topic
        assert isinstance(message, TOPICS[topic].message)
        assert message.source == case.name
        assert message.seq == last.get(topic, message.seq - 1) + 1, topic
        last[topic] = message.seq
        encode(message)


def encoded(outputs: list[Any]) -> list[bytes]:
    """Outputs as bytes, so that NaN equals NaN."""
    return [encode(output[1] if isinstance(output, tuple) else output) for output in outputs]


def histories(topics: tuple[str, ...]) -> st.SearchStrategy[list[tuple[str, Message]]]:
    """Sequences of messages of these topics: half of them plausible in time, half of them anything."""
    if not topics:
        return st.just([])
    one = st.sampled_from(sorted(topics)).flatmap(
        lambda topic: st.tuples(st.just(topic), _struct(TOPICS[topic].message))
    )
    return st.lists(one, max_size=12)


def _struct(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    hints = typing.get_type_hints(kind)
    fields = {name: _of(hints[name]) for name in kind.__struct_fields__}
    if "t_ns" in fields:
        near = st.integers(START_NS - NS_PER_S, START_NS + 3 * NS_PER_S)
        fields["t_ns"] = near | near | st.integers(0, 1 << 62)
        fields["timestamp"] = st.floats()
        fields["seq"] = st.integers(0, 50) | st.integers(0, 1 << 62)
    return st.builds(kind, **fields)


def _of(hint: Any) -> st.SearchStrategy[Any]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return _struct(hint)
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is dict:
        return st.dictionaries(st.sampled_from(GALEN_JOINTS) | st.text(max_size=6), _of(inner[1]), max_size=6)
    if origin is list:
        return st.lists(_of(inner[0]), max_size=9)
    simple = {
        float: st.floats(-50.0, 50.0) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300]),
        int: st.integers(0, 1 << 40),
        bool: st.booleans(),
        str: st.text(max_size=8),
    }
    return simple[hint]


def _command_words(cls: type[Service]) -> list[str]:
    """Words that commands and their arguments are made of, from the service's own description."""
    text = f"{cls.__doc__} enabled tool x y z file topics position roll"
    return sorted({word.strip(".,:;{}()`") for word in text.split() if word.strip(".,:;{}()`").isidentifier()})


def _inside(args: dict[str, Any]) -> dict[str, Any]:
    """No file outside the temporary directory: a name that would be one is cut to its last part."""
    return {
        k: Path(v).name if k in ("file", "path", "directory") and isinstance(v, str) else v for k, v in args.items()
    }
