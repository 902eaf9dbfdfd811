"""Requests to the motors: checked against limits and state before anything is sent, and answered when carried out."""

from typing import TYPE_CHECKING, Any, Final

from galen_hw.drivers.galil_dmc.axes import Axes
from galen_hw.drivers.galil_dmc.jobs import Finished, GalilJobs, Job
from galen_hw.drivers.galil_dmc.scripts import (
    CancelledError,
    RefusedError,
    Result,
    Script,
    SilentError,
    disable,
    enable,
    jog,
    move,
    one,
    status,
)
from galen_hw.drivers.galil_dmc.state import GalilState
from galen_hw.messages import CommandError, Reply, Request

if TYPE_CHECKING:
    from collections.abc import Callable

ARGUMENTS: Final[dict[str, frozenset[str]]] = {
    "enable": frozenset(),
    "disable": frozenset(),
    "move_jp": frozenset({"position", "velocity", "acceleration"}),
    "servo_jv": frozenset({"velocity"}),
    "stop": frozenset(),
    "abort": frozenset(),
    "clear_fault": frozenset(),
}
"""What each command takes."""


class GalilRequests:
    """Turns requests into scripts.

    Args:
        axes: names, limits and scales.
        state: what the controller last said.
        jobs: where scripts wait.

    `jogging` are the joints under servo_jv; `at_zero` says that the last one asked for no velocity at all.
    """

    def __init__(self, axes: Axes, state: GalilState, jobs: GalilJobs) -> None:
        self._axes, self._state, self._jobs = axes, state, jobs
        self.jogging: set[str] = set()
        self.at_zero = True
        self._make: dict[str, Callable[[dict[str, Any]], Script]] = {
            "enable": self._enable,
            "move_jp": self._move,
            "servo_jv": self._servo,
            "clear_fault": self._clear_fault,
            "stop": lambda _: one(f"ST {axes.letters}", {}),
            "abort": lambda _: one("AB 1", {}),
            "disable": lambda _: disable(axes.letters),
        }

    def take(self, request: Request, *, connected: bool, fault: str) -> list[Finished]:
        """Queue a request's script; the scripts that end for it.

        Raises:
            CommandRejectedError: not now, or not so far or fast. WrongCommandError: not known.
        """
        known = ARGUMENTS.get(request.name)
        if known is None:
            raise self._axes.wrong(f"no command {request.name!r}", f"the commands are {', '.join(ARGUMENTS)}")
        if unknown := request.args.keys() - known:
            raise self._axes.wrong(f"{request.name} takes no {', '.join(sorted(unknown))}", "")
        if not connected:
            raise self._axes.rejected(fault or "not connected yet", "wait until the status says ready")
        script = self._make[request.name](request.args)
        urgent = request.name in {"stop", "abort", "disable"}
        ended = self._jobs.cancel() if urgent else self._supersede(request.name)
        if urgent:
            self.jogging.clear()
        self._jobs.add(Job(request.name, script, request.id, urgent=urgent))
        return ended

    def reply(self, finished: Finished) -> Reply:
        """The answer to the request of a script that has ended."""
        job, error = finished.job, finished.error
        if error is None:
            return self._done(finished)
        kind, todo = "fault", ""
        what = f"{job.name}: {error}"
        if isinstance(error, RefusedError):
            kind, todo = "rejected", error.todo
        elif isinstance(error, CancelledError):
            kind, what = "rejected", f"{job.name}: cancelled by a stop"
        elif isinstance(error, SilentError):
            kind, what = "timeout", f"{job.name}: the controller did not answer, it may have been carried out"
            todo = "look at joints/state; the robot is told to stop as soon as it answers"
        return Reply(id=job.request_id, error=CommandError(kind=kind, what=what, where=self._axes.where, todo=todo))

    def _done(self, finished: Finished) -> Reply:
        job = finished.job
        if job.name != "clear_fault":
            return Reply(id=job.request_id, result=finished.result)
        if self._state.estop:
            what, todo = "emergency stop or abort input is still engaged", "release it first"
            return Reply(
                id=job.request_id,
                error=CommandError(kind="rejected", what=what, where=self._axes.where, todo=todo),
            )
        cleared = list(self._state.latched.values())
        self._state.latched.clear()
        return Reply(id=job.request_id, result={"cleared": cleared})

    def _supersede(self, name: str) -> list[Finished]:
        """A jog that has not been sent yet gives way to a newer one."""
        older = self._jobs.named("servo_jv") if name == "servo_jv" else None
        if older is None or not self._jobs.withdraw(older):
            return []
        result: Result = {"superseded": True}
        return [Finished(older, result)]

    def _clear_fault(self, args: dict[str, Any]) -> Script:
        del args
        return status(self._axes.letters)

    def _enable(self, args: dict[str, Any]) -> Script:
        del args
        self._no_fault()
        if self._state.moving:
            raise self._axes.rejected("the robot is moving", "stop it first")
        return enable(self._axes.letters)

    def _move(self, args: dict[str, Any]) -> Script:
        commands = self._axes.move(args)
        joints = list(args["position"])
        self._may_move()
        busy = [joint for joint in joints if joint in self._state.moving_joints]
        if busy or self._jobs.named("move_jp"):
            raise self._axes.rejected(
                f"{', '.join(busy) or 'the robot'} is still moving", "wait for its end, or stop it"
            )
        return move(self._axes.letters_of(joints), commands, joints)

    def _servo(self, args: dict[str, Any]) -> Script:
        velocity = self._axes.table(args, "velocity")
        if not velocity:
            raise self._axes.wrong("servo_jv names no velocity", "give velocity: {joint: value}")
        self._axes.jog(velocity)  # checks it against the limits
        self._may_move()
        for joint, value in velocity.items():
            if joint in self._state.moving_joints - self.jogging:
                raise self._axes.rejected(f"{joint} is moving to a position", "wait for its end, or stop it")
            lower, upper = self._state.at_limits(joint)
            if (upper and value > 0) or (lower and value < 0):
                side = "upper" if upper else "lower"
                raise self._axes.rejected(
                    f"{joint}: velocity {value:g} leads beyond the {side} limit it stands on", "move it the other way"
                )
        self.at_zero = not any(velocity.values())
        return jog(self._axes, velocity, self.jogging)

    def _no_fault(self) -> None:
        if self._state.estop:
            raise self._axes.rejected(
                "emergency stop or abort input is engaged", f"release it, then {self._axes.again}"
            )
        if self._state.latched:
            raise self._axes.rejected(
                "; ".join(self._state.latched.values()), f"remove the cause, then {self._axes.again}"
            )

    def _may_move(self) -> None:
        self._no_fault()
        if self._state.arming:
            raise self._axes.rejected("the controller's own time-out is being set up", "try again at once")
        if not self._state.enabled:
            raise self._axes.rejected("the motors are off", "enable first")
