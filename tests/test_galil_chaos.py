"""Whatever the line does, every request is answered once and nothing raises."""

import sys
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

import itertools

from galil_parts import Bench, ready

from galen_hw.errors import CommandRejectedError
from galen_hw.messages import Reply, Request

REQUESTS = [
    ("enable", {}),
    ("disable", {}),
    ("move_jp", {"position": {"roll": 0.3, "carriage2": -0.1}}),
    ("servo_jv", {"velocity": {"tilt": 0.2}}),
    ("stop", {}),
    ("abort", {}),
    ("clear_fault", {}),
]
EVENT = st.one_of(
    st.tuples(st.just("ask"), st.sampled_from(REQUESTS)),
    st.tuples(st.just("lose"), st.integers(0, 250)),
    st.tuples(st.just("noise"), st.binary(min_size=1, max_size=20)),
    st.tuples(st.just("dead"), st.booleans()),
    st.tuples(st.just("refuse"), st.sampled_from(["BG", "PA", "SH", "MO", "QR", "JG", "MG", "ST"])),
    st.tuples(st.just("wait"), st.floats(0.0005, 0.5)),
)


def damage(bench: Bench, kind: str, what: object) -> None:
    """Do to the line or the controller what an event says."""
    if kind == "lose" and bench.line and bench.line[0][1]:
        t_ns, data = bench.line[0]
        place = what % len(data)
        bench.line[0] = (t_ns, data[:place] + data[place + 1 :])
    elif kind == "noise":
        bench.feed(what)
    elif kind == "dead":
        bench.peer.dead = what
    elif kind == "refuse":
        bench.peer.refuse = {} if what in bench.peer.refuse else {what: 22}
    elif kind == "wait":
        bench.run(what)


@settings(max_examples=25)
@given(st.lists(EVENT, max_size=25), st.sampled_from([0, 1, 5]))
def test_every_accepted_request_is_answered_once(events, chunk):
    """Lost bytes, noise, refusals, dead times in any order; and when the line is well again, the robot comes back."""
    bench = ready(reply_timeout_s=0.05, reconnect_s=0.1)
    bench.chunk = chunk
    bench.outputs.clear()
    accepted = []
    for number, (kind, what) in enumerate(events):
        if kind != "ask":
            damage(bench, kind, what)
            continue
        request = Request(id=str(number), target="motors", name=what[0], args=what[1])
        try:
            bench.outputs += bench.device.request(request, bench.now_ns)
        except CommandRejectedError:
            continue
        accepted.append(request.id)
        bench.run(0.003)
    bench.peer.dead, bench.peer.refuse = False, {}
    bench.run(8.0)
    assert sorted(o.id for o in bench.outputs if isinstance(o, Reply)) == sorted(accepted)
    assert bench.device.ready
    states = bench.messages("joints/state")
    assert all(abs(value) < 1e-9 for state in states for value in state.position.values())
    assert all(b.seq == a.seq + 1 for a, b in itertools.pairwise(states))
