"""The dashboard's server without a browser: who may do what, what it shows, what it refuses, what its buttons do."""

import http.client
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, cast

import pytest

pytest.importorskip("starlette", reason="the extra [dashboard] is not installed")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from galen_hw.bus import Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.config.tool_file import Origin, ToolFile
from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import CommandRejectedError
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import Vector3, WrenchCompensated, WrenchRaw, encode, encode_batch
from galen_hw.tools.calibration import figures
from galen_hw.tools.dashboard import frames
from galen_hw.tools.dashboard.access import Access
from galen_hw.tools.dashboard.actions import Actions, report_file, reports, requests_of, tools
from galen_hw.tools.dashboard.arm import arm_lines
from galen_hw.tools.dashboard.bins import KEPT, Bins
from galen_hw.tools.dashboard.calibration import Calibration
from galen_hw.tools.dashboard.feed import MOST, Feed, why_not_valid
from galen_hw.tools.dashboard.server import MOST_PAGES, MOST_REFUSALS, Dashboard, listen, make_server
from tests.daemon_tree import daemon_tree


class Site:
    """A running dashboard.

    Args:
        url: of its page; access: its rules.
    """

    def __init__(self, url: str, access: Access) -> None:
        self.access = access
        self.host = url.removeprefix("http://").strip("/")

    def get(self, path: str, host: str | None = None) -> tuple[int, Any, str]:
        """Status, headers and text of a path, taken as it is."""
        connection = http.client.HTTPConnection(self.host, timeout=10)
        connection.request("GET", path, headers={"Host": self.host if host is None else host})
        answer = connection.getresponse()
        text = answer.read().decode(errors="replace")
        connection.close()
        return answer.status, answer.headers, text

    def open(self, origin: str | None = "own") -> ClientConnection:
        """A page's websocket."""
        own = f"http://{self.host}" if origin == "own" else origin
        return connect(f"ws://{self.host}/live", origin=own, compression=None, close_timeout=2)  # type: ignore[arg-type]


@contextmanager
def served(addresses: Addresses, **rules: Any) -> Iterator[Site]:
    """The real server on a port of its own."""
    access = Access("127.0.0.1", **rules)
    calibration = Calibration(addresses, {})
    dashboard = Dashboard(Feed(addresses), Actions(addresses, calibration), calibration, access)
    listener, url = listen("127.0.0.1", 0)
    server = make_server(dashboard.app)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield Site(url, access)
    finally:
        server.should_exit = True
        thread.join(15)
        listener.close()


def hear(page: ClientConnection, kind: str, until: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
    """The next message of a kind that holds; each of the others is one that was not meant."""
    for _ in range(600):
        message: dict[str, Any] = json.loads(page.recv(timeout=20))
        if message["type"] == kind and until(message):
            return message
    raise AssertionError(f"no {kind}")


def say(page: ClientConnection, **frame: Any) -> None:
    page.send(json.dumps({"n": 1} | frame))


def test_the_page_is_served_with_rules_that_keep_it_at_home(tmp_path: Path) -> None:
    """No script but its own, no other site's frame around it, no network; its parts are there, with uPlot's licence."""
    with served(Addresses(tmp_path)) as site:
        status, headers, text = site.get("/")
        rules = headers["content-security-policy"]
        assert status == 200
        assert "script-src 'self'" in rules
        assert "frame-ancestors 'none'" in rules
        assert site.access.token not in text
        for part in ("page.js", "page.css", "uPlot.iife.min.js", "uPlot.min.css", "icon.svg"):
            assert f"/static/{part}" in text
            assert site.get(f"/static/{part}")[0] == 200
        assert "Permission is hereby granted" in site.get("/static/uPlot.LICENSE.txt")[2]
        for path in ("/static/../server.py", "/static/%2e%2e/server.py", "/static/no.js", "/nothing"):
            assert site.get(path)[0] == 404


def test_no_part_of_the_page_comes_from_elsewhere() -> None:
    """It must work where there is no network: no address of another host in what we wrote."""
    folder = Path(frames.__file__).with_name("static")
    for file in folder.iterdir():
        if file.suffix in (".js", ".css", ".html") and "uPlot" not in file.name:
            text = file.read_text(encoding="utf-8")
            assert "https://" not in text, file.name
            assert "innerHTML" not in text, file.name


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "127.0.0.1.evil.example:8765", ""])
def test_another_name_for_this_address_is_refused(tmp_path: Path, host: str) -> None:
    """A site could point its own name at 127.0.0.1 and read the page as its own."""
    with served(Addresses(tmp_path)) as site:
        assert site.get("/", host)[0] == 403


def test_a_websocket_of_another_site_is_refused(tmp_path: Path) -> None:
    """A browser lets any page open a websocket to this machine; the server looks where the page is from."""
    with served(Addresses(tmp_path)) as site:
        odd = f"https://{site.host}", "http://127.0.0.1:1", "null", "http://[", f"http://{site.host}@evil.example"
        for origin in (None, "http://evil.example", *odd):
            with pytest.raises(InvalidStatus) as refused:
                site.open(origin)
            assert refused.value.response.status_code == 403, origin


def test_a_page_without_the_token_looks_and_cannot_touch(tmp_path: Path) -> None:
    """Each command is refused in words, the stop too; a wrong token opens nothing."""
    with served(Addresses(tmp_path)) as site, site.open() as page:
        assert hear(page, "welcome")["can_command"]
        assert hear(page, "live")["why"] == "No robot: the daemon does not run"
        for command in ({"do": "stop"}, {"do": "zero"}, {"do": "calibrate", "tool": "pointer"}):
            say(page, **command)
            answer = hear(page, "answer")
            assert not answer["ok"]
            assert "only look" in answer["text"]
        say(page, do="hello", token="x" * 32)
        assert not hear(page, "hello")["ok"]
        say(page, do="tare")
        assert "only look" in hear(page, "answer")["text"]


def end_of(page: ClientConnection) -> int | None:
    """The code with which the server closes the connection."""
    with pytest.raises(ConnectionClosed) as ended:
        hear(page, "no such kind")
    return ended.value.rcvd.code if ended.value.rcvd else None


@pytest.mark.parametrize("frame", [{"do": "hello", "token": "guess"}, {"do": "launch"}])
def test_guessing_tokens_and_talking_nonsense_ends_the_connection(tmp_path: Path, frame: dict[str, str]) -> None:
    """Five of either, each answered."""
    with served(Addresses(tmp_path)) as site, site.open() as page:
        for _ in range(MOST_REFUSALS):
            say(page, **frame)
        assert end_of(page) == 4400


def test_a_frame_that_is_too_large_ends_the_connection(tmp_path: Path) -> None:
    """Before it is stored."""
    with served(Addresses(tmp_path)) as site, site.open() as page:
        page.send("x" * 100_000)
        assert end_of(page) == 1009


def test_only_so_many_pages_at_a_time(tmp_path: Path) -> None:
    """One more is sent away with a word; it gets in when another has gone."""
    with served(Addresses(tmp_path)) as site:
        with ExitStack() as stack:
            for _ in range(MOST_PAGES):
                hear(stack.enter_context(site.open()), "welcome")
            with site.open() as one_more:
                assert end_of(one_more) == 4429
        with site.open() as page:
            hear(page, "welcome")


def test_beyond_this_machine_and_when_asked_for_nobody_may_command() -> None:
    """A token would go over the network in clear: there is none."""
    assert Access("127.0.0.1").token
    assert Access("::1").token
    for access in (Access("192.0.2.7"), Access("127.0.0.1", look_only=True)):
        assert access.token == ""
        assert not access.allows("")
    assert Access("192.0.2.7").knows("192.0.2.7:8765")
    assert not Access("192.0.2.7").knows("evil.example:8765")
    assert Access("::1").knows("[::1]:8765")
    assert "token" not in repr(Access("127.0.0.1")).replace("_token", "")


NO_FRAMES = (
    "",
    "[]",
    "{}",
    "[" * 900,
    '{"do": "tare"}',
    '{"do": "tare", "n": 1, "more": 2}',
    '{"do": "enable", "n": 1, "on": 1}',
    '{"do": "select", "n": 1}',
    '{"n": 1, "do": "zero"' + " " * 1100 + "}",
    '{"do": "hello", "n": 1, "token": "\ud800"}',
)


@pytest.mark.parametrize("text", NO_FRAMES)
def test_what_is_no_frame_is_refused_in_words(text: str) -> None:
    """Typed, bounded, nothing unknown, nothing left out."""
    with pytest.raises(frames.FrameError):
        frames.read_frame(text)


def test_each_button_is_the_request_that_the_command_line_would_send() -> None:
    """Target, name and arguments."""
    assert requests_of(frames.Select(n=1, tool="pointer"))[0] == [("compensation", "select_tool", {"tool": "pointer"})]
    assert requests_of(frames.Select(n=1, tool=None))[0] == [("compensation", "select_tool", {"tool": None})]
    assert requests_of(frames.Enable(n=1, on=False))[0] == [("compensation", "set_enabled", {"enabled": False})]
    assert requests_of(frames.Zero(n=1))[0] == [("ft", "zero", {})]
    assert [name for _, name, _ in requests_of(frames.Motors(n=1))[0]] == ["clear_fault", "enable"]
    assert requests_of(frames.Stop(n=1)) is None


def test_reports_are_given_out_of_their_folder_only(tmp_path: Path) -> None:
    """The newest first; nothing above, nothing else."""
    for n, name in enumerate(("pointer-0001", "pointer-0002")):
        (tmp_path / "reports" / name).mkdir(parents=True)
        (tmp_path / "reports" / name / "report.html").write_text(f"<p>{n}</p>")
    (tmp_path / "reports" / "pointer-0002" / "key.pem").write_text("secret")
    (tmp_path / "secret.html").write_text("secret")
    info = {"state_dir": str(tmp_path)}

    assert {r["name"] for r in reports(info)} == {"pointer-0001", "pointer-0002"}
    found = report_file(info, "pointer-0001", "report.html")
    assert found is not None
    assert found.read_text() == "<p>0</p>"
    for folder, name in (("..", "secret.html"), ("pointer-0002", "key.pem"), (".", "report.html")):
        assert report_file(info, folder, name) is None
    assert report_file(info, "pointer-0001", "../../secret.html") is None
    assert reports({}) == []


def test_the_report_of_a_calibration_is_where_the_page_links_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link that the last step shows is one that is served, and one of the list: a page without .html was neither."""
    monkeypatch.setattr(figures, "figures", lambda *_: [])
    monkeypatch.setattr(figures, "render", lambda *_: "<title>pointer</title>")
    origin = Origin(date="2001-09-09T01:46:40+00:00", software="t", robot="galen", method="t", generation=1)
    file = ToolFile(schema=1, name="pointer", tip=(0.0, 0.0, 0.1), origin=origin)
    calibration = Calibration(Addresses(tmp_path / "run"), {})
    link = calibration._report(ToolStore(tmp_path, virtual=True), file, cast("Any", None), None)

    info = {"state_dir": str(tmp_path)}
    assert [report["link"] for report in reports(info)] == [link]
    found = report_file(info, *link.split("/"))
    assert found is not None
    assert found.read_text() == "<title>pointer</title>"


def test_the_list_of_tools_says_which_can_be_taken_in_hand(tmp_path: Path) -> None:
    """Those of the package, never calibrated yet."""
    found = tools({"state_dir": str(tmp_path), "virtual": True})

    assert {tool["name"] for tool in found} >= {"pointer", "retractor"}
    assert not any(tool["calibrated"] for tool in found)


def wrench(t_ns: int, x: float, *, valid: bool = True, **more: Any) -> WrenchCompensated:
    return WrenchCompensated(timestamp=0.0, t_ns=t_ns, seq=0, valid=valid, force=Vector3(x=x), torque=Vector3(), **more)


def raw(t_ns: int, x: float, **more: Any) -> WrenchRaw:
    return WrenchRaw(timestamp=0.0, t_ns=t_ns, seq=0, valid=True, force=Vector3(x=x), torque=Vector3(), **more)


def test_a_thousand_samples_a_second_are_fifty_means() -> None:
    """Means of 20 ms of both, the share that was valid, and what a page has not been sent yet."""
    bins = Bins()
    for n in range(1000):
        bins.add(raw(n * 1_000_000, n // 20))
        bins.add(wrench(n * 1_000_000, -n // 20, valid=n < 500))
    rows = bins.since(0)

    assert len(rows) == bins.count == 49
    assert [row[1] for row in rows] == list(range(49))
    assert rows[10][0] == pytest.approx(0.2)
    assert rows[10][13] == 1.0
    assert rows[40][13] == 0.0
    assert bins.since(47) == rows[47:]
    for n in range(60_000):
        bins.add(raw(n * 1_000_000 + 10**10, 0.0))
    assert len(bins.since(0)) == KEPT
    assert bins.since(bins.count) == []


def test_why_a_wrench_must_not_be_used_is_said_in_an_operators_words() -> None:
    """The first thing that is wrong, with what to do."""
    now, t = 100.0, 10**11
    assert why_not_valid(now, raw(t, 0), wrench(t, 0)) == ""
    assert "not zeroed" in why_not_valid(now, raw(t, 0), wrench(t, 0, valid=False, unzeroed=True))
    assert why_not_valid(now, raw(t - 3 * 10**9, 0), wrench(t, 0)) == "The sensor is silent for 3 s"
    assert why_not_valid(now, raw(t - 3 * 10**9, 0), wrench(t, 0), 3.0) == "The sensor is silent for 3 s"
    assert "too busy" in why_not_valid(now, raw(t - 3 * 10**9, 0), wrench(t, 0), 0.01)
    assert why_not_valid(now, None, None) == "The sensor is silent"
    assert why_not_valid(now, raw(t, 0), None) == "The compensation is silent"
    assert "at its limit" in why_not_valid(now, raw(t, 0, saturated=True), wrench(t, 0, valid=False))
    assert "not valid" in why_not_valid(now, raw(t, 0), wrench(t, 0, valid=False))


def test_the_arm_is_drawn_from_its_own_kinematics() -> None:
    """At home: platform above the base, the sensor where the kinematics have it, rods of the nominal length."""
    robot = GalenRobot()
    q = [0.01, 0.0, 0.0, 0.2, 0.1]
    found = arm_lines(robot, q)
    rods = found["lines"][1::2]

    assert found["sensor"] == pytest.approx(robot.sensor_pose(q)[0, :3, 3], abs=1e-5)
    assert len(rods) == 3
    for low, high in rods:
        assert sum((a - b) ** 2 for a, b in zip(low, high, strict=True)) ** 0.5 == pytest.approx(0.4, abs=1e-4)


@pytest.fixture
def tree(tmp_path: Path) -> Iterator[Any]:
    with daemon_tree(tmp_path) as tree:
        tree.write_config("[services.health]\n")
        tree.start_ready()
        yield tree


def test_a_running_daemon_is_shown_live_and_commanded_with_the_token(tree: Any) -> None:
    """Traces, health and the robot's name over its own bus; a stop reaches the motors' wire."""
    with served(tree.addresses) as site, site.open() as page:
        live = hear(page, "live", lambda m: bool(m["bins"]))
        assert len(live["bins"][0]) == 14
        assert hear(page, "about", lambda m: m["daemon"])["virtual"] is False
        assert hear(page, "health")["parts"]["daemon.core"] in ("ready", "degraded")
        say(page, do="hello", token=site.access.token)
        assert hear(page, "hello")["ok"]
        tree.motors.hush()
        say(page, do="stop", n=7)
        assert tree.motors.hear(b"STOP")
        answer = hear(page, "answer")
        assert (answer["n"], answer["ok"], answer["text"]) == (7, True, "Stopped")
        say(page, do="zero")
        answer = hear(page, "answer")
        assert not answer["ok"]
        assert "no command 'zero'" in answer["text"]


def test_nothing_is_heard_while_no_page_is_open(tree: Any) -> None:
    """A dashboard that nobody looks at costs the bus nothing."""
    feed = Feed(tree.addresses)
    for _ in range(2):
        before = feed.bins.count
        feed.open()
        until = time.monotonic() + 10
        while feed.bins.count == before and time.monotonic() < until:
            feed._end.wait(0.02)
        feed.close()
        for thread in feed._threads:
            thread.join(5)
        assert feed.bins.count > before
        assert not any(thread.is_alive() for thread in feed._threads)


def test_what_had_piled_up_is_read_past(tree: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that could not keep up shows the present at its next turn, and leaves a gap in the traces."""
    sent = [(b"wrench/raw", encode(raw(n * 1_000_000, n))) for n in range(3 * MOST)]
    frames = [(b"batch", encode_batch(sent[k : k + 25])) for k in range(0, len(sent), 25)]
    monkeypatch.setattr(Subscriber, "receive_bytes", lambda _self, _wait: frames.pop(0) if frames else None)
    feed = Feed(tree.addresses)
    feed.open()
    until = time.monotonic() + 10
    while frames and time.monotonic() < until:
        feed._end.wait(0.02)
    feed.close()
    for thread in feed._threads:
        thread.join(5)
    last = feed.last("wrench/raw")
    assert last is not None
    assert last.t_ns == (3 * MOST - 1) * 1_000_000
    assert feed.bins.count == MOST // 20 - 1


def test_a_page_that_is_opened_later_knows_nothing_of_before(tree: Any) -> None:
    """Nobody looked for an hour: that is no silence of the sensor."""
    feed = Feed(tree.addresses)
    feed._take(b"wrench/raw", encode(raw(1, 0.0)), feed.bins)
    feed.open()
    feed.close()
    for thread in feed._threads:
        thread.join(5)
    heard = feed.last("wrench/raw")
    assert heard is None or heard.t_ns != 1


def test_a_daemon_that_ends_is_said_within_seconds(tree: Any) -> None:
    """The page hears on; what it shows is not the present."""
    with served(tree.addresses) as site, site.open() as page:
        hear(page, "live", lambda m: bool(m["bins"]))
        tree.end()
        assert hear(page, "live", lambda m: "No robot" in m["why"])
        assert not hear(page, "about", lambda m: not m["daemon"])["ready"]


def test_one_calibration_at_a_time_and_its_failure_is_said(tmp_path: Path) -> None:
    """Without a daemon it fails in words; while one waits, a second is refused; a page that is gone ends it."""
    calibration = Calibration(Addresses(tmp_path), {})
    calibration._calibrate = lambda tool: calibration._wait("bare", 20.0)  # type: ignore[method-assign]
    calibration.start("pointer", "page 1")
    with pytest.raises(CommandRejectedError, match="under way"):
        calibration.start("pointer", "page 2")
    assert calibration._thread is not None
    calibration._thread.join(10)
    assert calibration.state["step"] == "failed"
    assert "the page that began it was closed" in calibration.state["what"]
