"""The queue of scripts on a Galil's line: one runs at a time, a stop goes first, joint states keep their share."""

from collections import deque
from dataclasses import dataclass
from typing import Final, TypeAlias

from galen_hw.drivers.galil_dmc.link import Answer, Exchange, GalilLink
from galen_hw.drivers.galil_dmc.scripts import (
    CancelledError,
    Quiet,
    RefusedError,
    Result,
    Script,
    SilentError,
    Step,
    WrongDeviceError,
)

_ENDS: Final = (RefusedError, SilentError, CancelledError, WrongDeviceError)


@dataclass(slots=True, eq=False)
class Job:
    """A script under way or waiting.

    Args:
        name: of the request, or of what the driver does by itself ("connect", "status").
        request_id: of the request to answer, empty for the driver's own.
        urgent: brings the robot to rest: goes first, and is not cancelled by another one.
    """

    name: str
    script: Script
    request_id: str = ""
    urgent: bool = False
    step: Step | None = None
    started: bool = False
    cancelled: bool = False


@dataclass(frozen=True, slots=True)
class Finished:
    """A script's end: `error` is None, or why there is no result."""

    job: Job
    result: Result
    error: Exception | None = None


Event: TypeAlias = Answer | Finished


class GalilJobs:
    """Runs scripts over a link.

    Args:
        link: the line.
    """

    def __init__(self, link: GalilLink) -> None:
        self.link = link
        self.silences = 0
        self.reset()

    def reset(self) -> None:
        """Forget all; `abandon` first to answer what waits."""
        self.link.reset()
        self._current: Job | None = None
        self._queue: deque[Job] = deque()
        self._asked: Job | None = None
        self._quiet_for: Job | None = None
        self._owes_record = False

    def add(self, job: Job) -> None:
        """Queue a script; an urgent one goes before all that are not."""
        if not job.urgent:
            self._queue.append(job)
            return
        place = sum(other.urgent for other in self._queue)
        self._queue.insert(place, job)

    def named(self, name: str) -> Job | None:
        """The waiting or running script of that name."""
        waiting = [job for job in self._queue if job.name == name]
        if waiting:
            return waiting[0]
        return self._current if self._current is not None and self._current.name == name else None

    def withdraw(self, job: Job) -> bool:
        """Take a script that has not begun out of the queue."""
        if job not in self._queue:
            return False
        self._queue.remove(job)
        return True

    def cancel(self) -> list[Finished]:
        """End what would move the robot: at once where nothing was sent, after the pending answer otherwise."""
        gone = [job for job in self._queue if not job.urgent and job.request_id]
        for job in gone:
            self._queue.remove(job)
        if self._current is not None and not self._current.urgent and self._current.request_id:
            self._current.cancelled = True
        return [Finished(job, {}, CancelledError()) for job in gone]

    def abandon(self, error: Exception) -> list[Finished]:
        """End everything."""
        jobs = [*([self._current] if self._current else []), *self._queue]
        self._current = self._quiet_for = None
        self._queue.clear()
        return [Finished(job, {}, error) for job in jobs]

    def poll(self, now_ns: int) -> tuple[list[bytes], list[Finished]]:
        """What time alone brings: an overdue answer drains the line and ends its script."""
        if self.link.expired(now_ns):
            self.silences += 1
            wire = self.link.drain(now_ns)
            self._owes_record = True
            ended = [] if self._asked is None else self._advance(self._asked, SilentError())
            return [wire], ended
        if self.link.settled(now_ns) and self._quiet_for is not None:
            job, self._quiet_for = self._quiet_for, None
            return [], self._advance(job, None)
        return [], []

    def wires(
        self, now_ns: int, record: Exchange | None, beat: Exchange | None = None
    ) -> tuple[list[bytes], list[Finished]]:
        """What to send now, if the line is idle: `beat`, between the steps of a script too; the next step; or `record`."""
        ended: list[Finished] = []
        if beat is not None and self.link.idle:
            self._asked = None
            return [self.link.send(beat, now_ns)], ended
        while self.link.idle:
            if self._current is None:
                if record is not None and (self._owes_record or not self._queue) and not self._urgent:
                    self._owes_record = False
                    self._asked = None
                    return [self.link.send(record, now_ns)], ended
                if not self._queue:
                    break
                self._current = self._queue.popleft()
            job = self._current
            if not job.started:
                job.started = True
                ended += self._advance(job, None)
                continue
            return [self._send(job, now_ns)], ended
        return [], ended

    @property
    def pending(self) -> bool:
        """There is something to send as soon as the line is idle."""
        return self._current is not None or bool(self._queue)

    @property
    def _urgent(self) -> bool:
        return bool(self._queue) and self._queue[0].urgent

    def feed(self, data: bytes, t_ns: int) -> list[Event]:
        """Answers, each before the end of the script that it completes."""
        events: list[Event] = []
        for answer in self.link.feed(data, t_ns):
            self.silences = 0
            events.append(answer)
            if self._asked is not None:
                events += self._advance(self._asked, answer)
        return events

    def _send(self, job: Job, now_ns: int) -> bytes:
        step = job.step
        if isinstance(step, Exchange):
            self._asked = job
            return self.link.send(step, now_ns)
        assert isinstance(step, Quiet)
        self._quiet_for = job
        return self.link.drain(now_ns)

    def _advance(self, job: Job, given: Answer | Exception | None) -> list[Finished]:
        """Give a script its answer; its end, if that was the last."""
        if job is not self._current:
            return []
        if job.cancelled:
            given = CancelledError()
        try:
            job.step = job.script.throw(given) if isinstance(given, Exception) else job.script.send(given)
        except StopIteration as end:
            finished = Finished(job, end.value)
        except _ENDS as error:
            finished = Finished(job, {}, error)
        else:
            return []
        self._current = None
        self._owes_record = True
        return [finished]
