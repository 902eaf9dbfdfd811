"""A driver and its virtual counterpart joined by two buffers and one clock that is turned by hand."""

from galen_hw.clock import TimeBase
from galen_hw.messages import Reply, Request

LATENCY_NS = 100_000


class Pair:
    """Runs both ends in simulated time and keeps what the driver said."""

    def __init__(self, driver, device):
        self.driver, self.device = driver, device
        self.now_ns = 10**9
        self.said = []
        self.replies = {}
        driver.start(self.now_ns)

    def run(self, seconds, until=None):
        """Let time pass; stops early when `until()` holds. Returns whether it did (True without a condition)."""
        end = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end:
            self._turn()
            if until is not None and until():
                return True
            due = min(self.driver.wakeup_ns, self.device.wakeup_ns)
            self.now_ns = min(max(due, self.now_ns + LATENCY_NS), self.now_ns + 5_000_000)
        return until is None

    def _turn(self):
        wires, outputs = self.driver.poll(self.now_ns)
        self._keep(outputs)
        for wire in wires:
            self.device.feed(wire, self.now_ns)
        for wire in self.device.poll(self.now_ns):
            self._keep(self.driver.feed(wire, self.now_ns))

    def _keep(self, outputs):
        for output in outputs:
            if isinstance(output, Reply):
                self.replies[output.id] = output
            else:
                self.said.append(output)

    def of(self, topic):
        """Messages of a topic."""
        return [message for name, message in self.said if name == topic]

    def call(self, name, args=None, seconds=3.0):
        """A request and its reply."""
        key = f"r{len(self.replies)}"
        request = Request(id=key, target=self.driver.name, name=name, args=args or {})
        self._keep(self.driver.request(request, self.now_ns))
        assert self.run(seconds, lambda: key in self.replies), f"no reply to {name}"
        return self.replies[key]


TIME_BASE = TimeBase(0)
