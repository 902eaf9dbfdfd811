"""`health` as Prometheus text (exposition format 0.0.4), and a server of it on loopback."""

import math
import re
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final

from galen_hw.errors import HardwareError
from galen_hw.messages import Health

LEVEL: Final = {"good": 0, "advice": 1, "warning": 2, "fault": 3}
ALLOWED_HOSTS: Final = ("127.0.0.1", "localhost", "[::1]")
_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
_TOPIC_GAUGES: Final = {
    # field of TopicHealth: metric, help
    "rate_hz": ("topic_rate_hertz", "messages published a second"),
    "nominal_hz": ("topic_nominal_rate_hertz", "messages a second that are meant"),
    "lost_share": ("topic_lost_ratio", "share of the messages that were lost on the way"),
    "valid_share": ("topic_valid_ratio", "share of the messages that are valid"),
    "p50_s": ("topic_age_p50_seconds", "age when published, median of the last second"),
    "p99_s": ("topic_age_p99_seconds", "age when published, 99th percentile of the last second"),
    "worst_s": ("topic_age_worst_seconds", "age when published, the worst of the last second"),
}


def metrics(health: Health | None) -> str:
    """The text; of no daemon: `galen_hw_up 0` alone."""
    lines = [*_head("up", "1 while the daemon says how it is"), f"galen_hw_up {int(health is not None)}"]
    if health is None:
        return "\n".join(lines) + "\n"
    labels = {
        "robot": health.robot,
        "virtual": str(health.virtual).lower(),
        "version": health.versions.get("galen_hw", ""),
    }
    lines += [*_head("info", "which robot and version"), f"galen_hw_info{_labels(labels)} 1"]
    lines += [*_head("health", "0 good, 1 advice, 2 warning, 3 fault"), f"galen_hw_health {LEVEL.get(health.state, 3)}"]
    lines += _head("alarm", "an alarm that is on, by its cause: 1 advice, 2 warning, 3 fault")
    lines += [f"galen_hw_alarm{_labels({'cause': a.cause})} {LEVEL.get(a.level, 3)}" for a in health.alarms]
    lines += _head("part_up", "1 while a source of status is ready")
    lines += [f"galen_hw_part_up{_labels({'part': n})} {int(s == 'ready')}" for n, s in sorted(health.parts.items())]
    for field, (name, text) in _TOPIC_GAUGES.items():
        lines += _head(name, text)
        for topic, row in sorted(health.topics.items()):
            lines.append(f"galen_hw_{name}{_labels({'topic': topic})} {_number(getattr(row, field))}")
    lines += _head("gauge", "a gauge of health, by its name, which holds its unit")
    lines += [f"galen_hw_gauge{_labels({'name': n})} {_number(x)}" for n, x in sorted(health.gauges.items())]
    for name, count in sorted(health.counters.items()):
        lines += [*_head(f"{_word(name)}_total", name, "counter"), f"galen_hw_{_word(name)}_total {count}"]
    return "\n".join(lines) + "\n"


def _head(name: str, text: str, kind: str = "gauge") -> list[str]:
    return [f"# HELP galen_hw_{name} {text}", f"# TYPE galen_hw_{name} {kind}"]


def _labels(labels: dict[str, str]) -> str:
    escaped = {k: v.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n") for k, v in labels.items()}
    return "{" + ",".join(f'{key}="{value}"' for key, value in escaped.items()) + "}"


def _number(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return repr(float(value)) if math.isfinite(value) else "+Inf" if value > 0 else "-Inf"


def _word(name: str) -> str:
    return re.sub(r"[^a-zA-Z0-9_]", "_", name)


class MetricsServer(ThreadingHTTPServer):
    """Serves `/metrics` on 127.0.0.1, nothing else, and only under that name (a page of another site cannot read it).

    Args:
        port: 0 for any free one; text: makes the answer.

    Raises:
        HardwareError: the port cannot be had.
    """

    daemon_threads = True

    def __init__(self, port: int, text: Callable[[], str]) -> None:
        self.text = text
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise HardwareError(
                f"cannot listen ({error.strerror})", where=f"127.0.0.1:{port}", todo="give another port"
            ) from None

    @property
    def url(self) -> str:
        """Where it is."""
        return f"http://127.0.0.1:{self.server_address[1]}/metrics"


class _Handler(BaseHTTPRequestHandler):
    server: MetricsServer
    timeout = 10.0
    server_version, sys_version = "galen-hw", ""

    def do_GET(self) -> None:
        """Answer."""
        host = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        if host not in ALLOWED_HOSTS:
            self.send_error(403)
        elif self.path != "/metrics":
            self.send_error(404)
        else:
            body = self.server.text().encode()
            self.send_response(200)
            self.send_header("Content-Type", _TYPE)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the library's name
        """Log nothing: a line a scrape helps nobody."""
