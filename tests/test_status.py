"""`galen-hw status`, its Prometheus text, and what the daemon's processes measure and log."""

import io
import json
import logging
import os
import signal
import subprocess
import threading
import urllib.error
import urllib.request
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from galen_hw.clock import NS_PER_S
from galen_hw.daemon.ages import Ages
from galen_hw.daemon.logs import JournalFormatter, OncePerSecond, is_journal
from galen_hw.messages import Alarm, Health, TopicHealth
from galen_hw.tools.metrics import MetricsServer, metrics
from galen_hw.tools.status import as_json, show
from tests.daemon_tree import Tree, daemon_tree, within

HEALTH = Health(
    timestamp=1.0,
    t_ns=1,
    seq=0,
    robot="galen",
    state="warning",
    alarms=[Alarm(cause="drift", level="warning", what='a "drift"')],
    parts={"ft": "ready", "motors": "silent"},
    topics={"wrench/raw": TopicHealth(rate_hz=999.5, nominal_hz=1000.0, p99_s=0.002)},
    gauges={"drift_n_per_s": 0.2, "rest_s": float("nan")},
    counters={"lost": 3},
)


def test_prometheus_text_has_help_type_and_value_of_each() -> None:
    """Every metric once with its head; labels quoted; NaN as Prometheus writes it."""
    lines = metrics(HEALTH).splitlines()

    assert "galen_hw_up 1" in lines
    assert "galen_hw_health 2" in lines
    assert 'galen_hw_alarm{cause="drift"} 2' in lines
    assert 'galen_hw_part_up{part="motors"} 0' in lines
    assert 'galen_hw_topic_rate_hertz{topic="wrench/raw"} 999.5' in lines
    assert 'galen_hw_gauge{name="rest_s"} NaN' in lines
    assert "galen_hw_lost_total 3" in lines
    heads = [line.split()[2] for line in lines if line.startswith("# TYPE")]
    assert len(heads) == len(set(heads))
    values = {line.split("{")[0].split()[0] for line in lines if not line.startswith("#")}
    assert values <= set(heads)
    assert metrics(None).splitlines()[-1] == "galen_hw_up 0"


def test_what_to_do_stands_beside_each_alarm_for_people_and_scripts() -> None:
    """One line an alarm; the same word in JSON."""
    alarm = Alarm(cause="degraded ft", level="advice", what="ft: [bus] error", todo="check its cable")
    health = msgspec.structs.replace(HEALTH, alarms=[alarm])
    info = {"ready": True, "processes": {}, "config": "galen.toml"}
    text = io.StringIO()
    show(Console(file=text, width=120), health, info)
    assert "ft: [bus] error; check its cable" in text.getvalue()
    assert as_json(health, info)["alarms"][0]["todo"] == "check its cable"


def test_a_share_that_nobody_counts_is_not_shown_as_one() -> None:
    """It had been "lost 0, valid 100 %" for every topic but the compensated wrench, whatever was published."""
    info = {"ready": True, "processes": {}, "config": "galen.toml"}
    text = io.StringIO()
    show(Console(file=text, width=120), HEALTH, info)
    (row,) = (line.split() for line in text.getvalue().splitlines() if line.startswith("wrench/raw"))
    assert row == ["wrench/raw", "999.5", "1000", "-", "-", "0.00", "2.00"]
    topic = as_json(HEALTH, info)["topics"]["wrench/raw"]
    assert (topic["valid_share"], topic["lost_share"]) == (None, None)
    assert 'galen_hw_topic_valid_ratio{topic="wrench/raw"} NaN' in metrics(HEALTH)


def test_the_server_answers_on_loopback_under_its_own_name_only() -> None:
    """`/metrics` is served; another path, or another site's name for this address, is not."""
    with MetricsServer(0, lambda: metrics(HEALTH)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        with urllib.request.urlopen(server.url) as answer:
            assert "version=0.0.4" in answer.headers["Content-Type"]
            assert answer.read().decode() == metrics(HEALTH)
        for url, host, status in ((server.url + "x", "127.0.0.1", 404), (server.url, "evil.example", 403)):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(urllib.request.Request(url, headers={"Host": host}))
            assert refused.value.code == status
            refused.value.close()
        server.shutdown()
        thread.join()


def test_percentiles_of_ages_are_right_to_an_eighth() -> None:
    """A thousand ages from 1 to 1000 us; nothing is left after they were taken."""
    ages = Ages()
    for n in range(1, 1001):
        ages.add(n * 1000)
    found = ages.take()

    assert found is not None
    assert found[0] == pytest.approx(500e-6, rel=0.13)
    assert found[1] == pytest.approx(990e-6, rel=0.13)
    assert found[2] == pytest.approx(1000e-6, rel=1e-9)
    assert found[0] >= 500e-6
    assert ages.take() is None
    for odd in (-5, 0, 1 << 70):
        ages.add(odd)
    assert ages.take() is not None


def record(text: str, *args: object) -> logging.LogRecord:
    return logging.LogRecord("galen-hw", logging.ERROR, "", 0, text, args, None)


def test_a_cause_is_logged_once_a_second_and_what_was_left_out_is_counted() -> None:
    """The numbers of a line make no other cause, a name does."""
    now = 0.0
    once = OncePerSecond(lambda: now)
    passed = []
    for n in range(25):
        now = n / 10.0
        for device in ("ft", "motors"):
            line = record("%s: silent for %.1f s", device, now)
            if once.filter(line):
                passed.append(line.getMessage())

    assert passed[0] == "ft: silent for 0.0 s"
    assert len(passed) == 6
    assert passed[2] == "ft: silent for 1.0 s (and 9 more like this)"


def test_the_journal_gets_priorities_on_every_line() -> None:
    """`<3>` is an error; a traceback is an error on each of its lines."""
    assert JournalFormatter().format(record("one\ntwo")) == "<3>one\n<3>two"


def test_only_systemds_own_stream_is_the_journal(tmp_path: Path) -> None:
    """JOURNAL_STREAM is inherited by what a unit starts with another stderr."""
    with (tmp_path / "x").open("w") as file:
        found = (tmp_path / "x").stat()
        assert is_journal(file.fileno(), {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"})
        assert not is_journal(file.fileno(), {"JOURNAL_STREAM": "1:2"})
        assert not is_journal(file.fileno(), {})


def status(tree: Tree, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(tree.command("status", *words), env=tree.environ, capture_output=True, text=True, check=False)


def test_status_tells_of_a_running_daemon(tmp_path: Path) -> None:
    """Rates, ages and parts from its own processes; the disk; the status is 0 while all is well."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config("[services.health]\n")
        tree.start_ready()
        for _ in range(20):
            done = status(tree, "--json")
            found = json.loads(done.stdout) if done.stdout else {"topics": {}}
            if "wrench/raw" in found["topics"] and found["topics"]["wrench/raw"]["rate_hz"] > 0:
                break
        text = status(tree).stdout

    assert found["schema"] == 1
    assert found["virtual"] is False
    assert found["parts"]["daemon.core"] in ("ready", "degraded")  # on a busy machine
    assert found["topics"]["wrench/raw"]["p99_s"] > 0.0
    assert found["gauges"]["daemon.core disk_free_bytes"] > 0
    assert found["processes"]["health"] > 0
    assert "daemon.motion" in text


def test_the_arm_goes_on_when_the_process_that_looks_dies(tmp_path: Path) -> None:
    """It is started again, however often; the motors are not told to stop, as they are for any other."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config("[services.health]\n")
        tree.start_ready()
        for _ in range(2):
            before = tree.call("daemon", "info")["processes"]["health"]
            os.kill(before, signal.SIGKILL)
            assert within(
                60, lambda before=before: tree.call("daemon", "info")["processes"]["health"] not in (0, before)
            )
        tree.motors.hear(b"no such word", timeout_s=0.2)
        assert b"STOP" not in tree.motors.heard
        assert tree.call("daemon", "info")["ready"]


def test_status_without_the_service_says_what_to_add(tmp_path: Path) -> None:
    """And a daemon that is not there is said as such."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config()
        tree.start_ready()
        done = status(tree)
    assert done.returncode == 2
    assert "add [services.health]" in done.stderr
    with daemon_tree(tmp_path) as tree:
        done = status(tree, "--json")
    assert done.returncode == 3
    assert "no daemon runs here" in done.stderr


def test_nanoseconds_are_seconds() -> None:
    """The figures of `Ages` are in seconds."""
    ages = Ages()
    ages.add(2 * NS_PER_S)
    found = ages.take()
    assert found is not None
    assert found[2] == 2.0
